"""Risk setting: the effect of the spread of predictions on the cost of plans."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import torch
from jaxtyping import Float
from scipy import stats
from torch import Tensor, nn

from offpiste.core.errors import PlanningError
from offpiste.core.state import TerrainSource, Trajectory
from offpiste.dynamics.kernels.layout import COMMANDS
from offpiste.dynamics.kernels.networks import linear_layers
from offpiste.dynamics.vehicle import Vehicle
from offpiste.uncertainty.spread import MOTION, Spread, inputs_along, inputs_of


@dataclass(frozen=True)
class AsPredicted:
    """The spread has no effect."""

    kind: Literal["none"] = "none"


@dataclass(frozen=True)
class AddSpread:
    """A multiple of the predicted scale of position errors is added to the distance from the course.

    Raises:
        PlanningError: the factor is negative, or not finite.
    """

    times: float = 1.0
    kind: Literal["spread"] = "spread"

    def __post_init__(self) -> None:
        if not 0 <= self.times < math.inf:
            how = "give a finite factor of 0 or more"
            raise PlanningError(f"invalid risk factor {self.times:g}", how=how)


@dataclass(frozen=True)
class WorstShare:
    """The mean of the largest errors is added to the distance from the course: CVaR of the spread's Student t.

    Attributes:
        share: share of the largest errors.

    Raises:
        PlanningError: the share is not above 0 and at most 1.
    """

    share: float = 0.2
    kind: Literal["cvar"] = "cvar"

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise PlanningError(f"invalid share of errors {self.share:g}", how="give a share above 0 and up to 1")


Risk = AsPredicted | AddSpread | WorstShare
"""Effect of the spread of predictions on the cost."""

KINDS: Final = ("none", "spread:TIMES", "cvar:SHARE")
"""Notation of risks."""


@dataclass(frozen=True)
class Caution:
    """Spread of a model and the number of its scales that count in the cost (`reach`)."""

    spread: Spread
    reach: float


class SpreadWeights(NamedTuple):
    """Network of a spread as compiled code reads it, its standardisation folded into the first layer.

    Attributes:
        inner, bias: hidden layer, input by input: motion, controls that kernels know (`layout.COMMANDS`), mean code.
        outer, outer_bias: output layer.
        start: variance of the velocity at the start, along and across.
        reach: number of scales that count, times the spread's factor.
    """

    inner: Float[Tensor, "I H"]
    bias: Float[Tensor, " H"]
    outer: Float[Tensor, "H 2"]
    outer_bias: Float[Tensor, " 2"]
    start: Float[Tensor, " 2"]
    reach: float


@torch.no_grad()
def spread_weights(caution: Caution, vehicle: Vehicle, codes: int) -> SpreadWeights:
    """Return the weights of a spread.

    Args:
        codes: length of the model's code.

    Raises:
        ValueError: the spread is of a model with other inputs.
    """
    spread, inputs = caution.spread, inputs_of(vehicle, codes)
    if len(spread.mean) != inputs:
        raise ValueError(f"the spread has {len(spread.mean)} inputs; this model's has {inputs}")
    first, last = linear_layers(spread.layers)
    scaled = first.weight / spread.deviation
    start, reach = nn.functional.softplus(spread.start).square(), caution.reach * float(spread.factor)
    before, controls = len(MOTION), [COMMANDS.index(name) for name in vehicle.control]
    motion, of_controls, of_codes = scaled.t().split((before, len(controls), codes))
    known = scaled.new_zeros(len(COMMANDS), len(scaled))
    known[controls] = of_controls
    inner, bias = torch.cat((motion, known, of_codes)), first.bias - scaled @ spread.mean
    return SpreadWeights(inner, bias, last.weight.t(), last.bias, start, reach)


def risk_of(text: str) -> Risk:
    """Parse a risk, one of `KINDS`.

    Raises:
        PlanningError: the text has another form.
    """
    kind, _, number = text.partition(":")
    made: dict[str, Callable[..., Risk]] = {"spread": AddSpread, "cvar": WorstShare}
    try:
        if text == "none":
            return AsPredicted()
        return made[kind](float(number)) if text != kind else made[kind]()
    except (KeyError, ValueError):
        raise PlanningError(f"unknown risk {text!r}", how=f"give one of {', '.join(KINDS)}") from None


def caution_of(risk: Risk, spread: Spread | None) -> Caution | None:
    """Return the caution of a risk; None for `AsPredicted`.

    Raises:
        PlanningError: the risk needs a spread, and the model has none.
    """
    if isinstance(risk, AsPredicted):
        return None
    if spread is None:
        how = "create one with `offpiste calibrate RUN --dataset DATASET`, or plan with the risk none"
        raise PlanningError(f"the risk {risk.kind!r} needs a spread, which the run does not have", how=how)
    if isinstance(risk, AddSpread):
        return Caution(spread, risk.times)
    return Caution(spread, mean_of_worst(risk.share, float(spread.freedom.detach())))


def mean_of_worst(share: float, freedom: float) -> float:
    """Return the mean size of the largest errors of one component, in units of its scale.

    E[|t| | |t| > q] = 2 f(q) (freedom + q²) / ((freedom - 1) share), P(|t| > q) = share.

    Args:
        share: share of the largest errors.
        freedom: degrees of freedom, above 1.
    """
    beyond = stats.t.isf(share / 2, freedom)
    return float(2 * stats.t.pdf(beyond, freedom) * (freedom + beyond**2) / ((freedom - 1) * share))


def position_margins(
    caution: Caution, vehicle: Vehicle, start: Float[Tensor, "K 6"], trajectory: Trajectory, controls: Tensor,
    source: TerrainSource,
) -> Float[Tensor, "K T 2"]:  # fmt: skip
    """Return the margins for position errors along and across the heading after each step [m].

    Args:
        start: state before the first step.
        controls: controls [K, T, U] in the vehicle's columns.
        source: terrain of the same rollouts.
    """
    inputs = inputs_along(vehicle, start, trajectory, controls, source)
    return caution.reach * caution.spread.at_every_step(inputs)[:, : controls.shape[1]]
