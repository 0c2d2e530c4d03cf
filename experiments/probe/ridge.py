"""Linear probes: ridge regression with a cross-validated penalty, and its scores with intervals."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import rankdata

from offpiste.evaluation.intervals import Resampling

PENALTIES = tuple(float(p) for p in 10.0 ** np.arange(-5, 2.1, 0.5))
"""Penalties to choose from, relative to the variance of a standardised feature."""


@dataclass(frozen=True)
class Ridge:
    """Ridge regression y = offset + ((x - mean) / scale) weights.

    Attributes:
        mean, scale: of the training features; the scale of a constant feature is infinite, so that it has no effect.
        penalty: the chosen penalty.
    """

    mean: Float[np.ndarray, " F"]
    scale: Float[np.ndarray, " F"]
    weights: Float[np.ndarray, " F"]
    offset: float
    penalty: float

    def predict(self, features: Float[np.ndarray, "n F"]) -> Float[np.ndarray, " n"]:
        """Predicted target of each row."""
        return self.offset + ((features.astype(np.float64) - self.mean) / self.scale) @ self.weights


def fit_ridge(
    features: Float[np.ndarray, "n F"],
    target: Float[np.ndarray, " n"],
    fold: Int[np.ndarray, " n"],
    penalties: tuple[float, ...] = PENALTIES,
) -> Ridge:
    """Fit on all rows with the penalty whose squared error on the folds left out is smallest.

    Args:
        features, target: finite.
        fold: number of each row's part in the cross-validation; with one part only, the largest penalty is taken.
    """
    x = features.astype(np.float64)
    # Scaled once: features that hardly vary in some folds would otherwise be blown up there.
    scale = x.std(axis=0)
    scale = np.where(scale > 1e-9 * (1 + np.abs(x).max(axis=0)), scale, np.inf)
    error = np.zeros(len(penalties))
    for number in np.unique(fold):
        out = fold == number
        if out.all():
            break
        mean, offset, weights = _path(x[~out], target[~out], scale, penalties)
        predicted = offset + ((x[out] - mean) / scale) @ weights
        error += np.square(target[out, None] - predicted).sum(axis=0)
    best = penalties[int(error.argmin())] if error.any() else max(penalties)
    mean, offset, weights = _path(x, target, scale, (best,))
    return Ridge(mean, scale, weights[:, 0], offset, best)


def _path(
    features: Float[np.ndarray, "n F"],
    target: Float[np.ndarray, " n"],
    scale: Float[np.ndarray, " F"],
    penalties: tuple[float, ...],
) -> tuple[Float[np.ndarray, " F"], float, Float[np.ndarray, "F k"]]:
    """Mean, offset and weights w = (X'X / n + penalty I)^-1 X'y / n for each penalty, X scaled, X and y centred."""
    mean, offset = features.mean(axis=0), float(target.mean())
    x = (features - mean) / scale
    gram, moment = x.T @ x / len(x), x.T @ (target - offset) / len(x)
    values, vectors = np.linalg.eigh(gram)
    return mean, offset, vectors @ ((vectors.T @ moment)[:, None] / (values.clip(0)[:, None] + np.array(penalties)))


@dataclass(frozen=True)
class Score:
    """Scores of predictions.

    Attributes:
        r2: 1 - squared error / squared deviation from the mean of the test cells; below 0 where that mean is better.
        rank: Spearman's correlation; NaN where either is constant.
        r2_ci95, rank_ci95: 95 % intervals from drives, and blocks in them, drawn with replacement (ranks stay
            those of all cells).
        n: cells.
    """

    r2: float
    r2_ci95: tuple[float, float]
    rank: float
    rank_ci95: tuple[float, float]
    n: int


def score(target: Float[np.ndarray, " n"], predicted: Float[np.ndarray, " n"], drawn: Resampling) -> Score:
    """Score predictions of a target.

    Args:
        drawn: resamples of the blocks that the rows belong to.
    """
    r2 = _resampled(target, predicted, drawn, _r2)
    ranks = rankdata(target), rankdata(predicted)
    rank = _resampled(*ranks, drawn, _correlation)
    return Score(r2[0], r2[1], rank[0], rank[1], len(target))


Statistic = Callable[[Float[np.ndarray, "6 ..."]], Float[np.ndarray, "..."]]
"""Function of the sums over rows of 1, y, p, y y, p p and y p."""


def _resampled(
    y: Float[np.ndarray, " n"], p: Float[np.ndarray, " n"], drawn: Resampling, statistic: Statistic
) -> tuple[float, tuple[float, float]]:
    """A statistic of all rows, and its interval over resampled blocks."""
    columns = (np.ones(len(y)), y, p, y * y, p * p, y * p)
    sums = np.stack([np.bincount(drawn.block, weights=c, minlength=drawn.blocks) for c in columns])
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(statistic(sums.sum(axis=1))), drawn.interval(statistic(sums @ drawn.draws.T))


def _r2(sums: Float[np.ndarray, "6 ..."]) -> Float[np.ndarray, "..."]:
    n, y, _, yy, pp, yp = sums
    spread = yy - y * y / n
    return np.where(spread > 1e-12 * yy, 1 - (yy - 2 * yp + pp) / spread, np.nan)


def _correlation(sums: Float[np.ndarray, "6 ..."]) -> Float[np.ndarray, "..."]:
    n, y, p, yy, pp, yp = sums
    along_y, along_p = yy - y * y / n, pp - p * p / n
    known = (along_y > 1e-12 * yy) & (along_p > 1e-12 * pp)
    return np.where(known, (yp - y * p / n) / np.sqrt((along_y * along_p).clip(1e-300)), np.nan)
