"""Errors of position as a bivariate Student t: its likelihood, its regions, and scores of predictions of it.

The heavy tails are needed: most windows go as predicted, and a few slip. Standard deviations are those of the scale
matrix, along and across the predicted heading; both share their degrees of freedom.
"""

import math

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy import special, stats
from torch import Tensor


def squared_distance(error: Float[Tensor, "*B 2"], scale: Float[Tensor, "*B 2"]) -> Float[Tensor, "*B"]:
    """Squared distance of an error from zero in units of the scales.

    Args:
        error: along and across [m].
        scale: of both [m].
    """
    return (error / scale).square().sum(dim=-1)


def negative_log_likelihood(
    error: Float[Tensor, "*B 2"], scale: Float[Tensor, "*B 2"], freedom: Float[Tensor, ""]
) -> Float[Tensor, "*B"]:
    """Negative log-likelihood of errors under a bivariate t: its constant does not depend on the degrees of freedom.

    Args:
        freedom: degrees of freedom, above 0.
    """
    tail = (freedom / 2 + 1) * torch.log1p(squared_distance(error, scale) / freedom)
    return math.log(2 * math.pi) + scale.log().sum(dim=-1) + tail


def probability_within(squared: Float[np.ndarray, "*B"], freedom: float) -> Float[np.ndarray, "*B"]:
    """Probability of an error nearer to zero than one of this squared distance: that of the region it lies on."""
    return np.asarray(1 - (1 + squared / freedom) ** (-freedom / 2))


def radius(probability: float, freedom: float) -> float:
    """Distance in units of the scales within which errors lie with a probability: the region's radius."""
    return math.sqrt(freedom * ((1 - probability) ** (-2 / freedom) - 1))


def crps(error: Float[np.ndarray, "*B"], scale: Float[np.ndarray, "*B"], freedom: float) -> Float[np.ndarray, "*B"]:
    """Continuous ranked probability score of one component [m]: 0 is perfect (Jordan et al. 2019, appendix A).

    Args:
        error, scale: of the component [m].
        freedom: degrees of freedom, above 1.
    """
    z = error / scale
    beta = special.beta(0.5, freedom - 0.5) / special.beta(0.5, freedom / 2) ** 2
    density, below = stats.t.pdf(z, freedom), stats.t.cdf(z, freedom)
    score = z * (2 * below - 1) + 2 * density * (freedom + z**2) / (freedom - 1)
    return np.asarray(scale * (score - 2 * math.sqrt(freedom) / (freedom - 1) * beta))


def area_under_curve(score: Float[np.ndarray, " N"], positive: Bool[np.ndarray, " N"]) -> float:
    """Probability that a positive has a higher score than another one, ties counting half; NaN without both."""
    positives, others = int(positive.sum()), int((~positive).sum())
    if not positives or not others:
        return math.nan
    ranks = stats.rankdata(score)
    return float((ranks[positive].sum() - positives * (positives + 1) / 2) / (positives * others))
