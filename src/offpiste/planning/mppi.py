"""Model predictive path integral control (MPPI).

After Williams, Drews, Goldfain, Rehg and Theodorou, "Information-theoretic model predictive control" (T-RO 2018,
algorithm 2), with the low-frequency noise of Vlahov et al. (RA-L 2024). The task enters only through the function that
computes the costs of control sequences (`driving_cost`, `kernel`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from offpiste.core.conventions import DT
from offpiste.core.errors import NoPlan
from offpiste.native.threads import single_threaded_torch
from offpiste.planning.controls import Limits, keep_within
from offpiste.planning.noise import Noise, coloured

CostOf = Callable[[Tensor], Tensor]
"""Costs [K] of control sequences [K, T, U]; sequences with a non-finite cost have no weight."""


@dataclass(frozen=True)
class Settings:
    """Settings of MPPI.

    Attributes:
        limits: bounds and rates of the controls.
        deviation: standard deviation of the noise of each control.
        samples: K; the first sample is the plan itself.
        temperature: lambda [cost].
        iterations: number of updates per plan.
        noise: unit noise (`planning.noise`).
        wide, width: share of samples with noise `width` times as large.
        fresh: share of samples around `rest` instead of the plan; the first of them is `rest` without noise.
        fresh_width: factor on the noise of the other fresh samples.
        rest: controls at rest; zeros if None.
        dt: duration of a step [s], for the rates.

    Raises:
        ValueError: a number is out of range.
    """

    limits: Limits
    deviation: tuple[float, ...]
    samples: int = 1024
    temperature: float = 1.0
    iterations: int = 1
    noise: Noise = coloured
    wide: float = 0.1
    width: float = 3.0
    fresh: float = 0.05
    fresh_width: float = 1.0
    rest: tuple[float, ...] | None = None
    dt: float = DT

    def __post_init__(self) -> None:
        if min(self.samples, self.iterations) < 1:
            raise ValueError(f"samples ({self.samples}) and iterations ({self.iterations}) must be at least 1")
        if not (0 < self.temperature < math.inf and 0 < self.dt < math.inf):
            raise ValueError(f"temperature ({self.temperature:g}) and dt ({self.dt:g} s) must be positive and finite")
        if min(self.fresh, self.wide) < 0 or self.fresh + self.wide > 1:
            raise ValueError(f"the shares fresh ({self.fresh:g}) and wide ({self.wide:g}) must be 0 to 1 in total")


@dataclass(frozen=True)
class Plan:
    """A plan and the samples of the last iteration.

    Attributes:
        controls: control of each step.
        costs: costs of the samples; the first sample is the plan before the last iteration.
        weights: weights of the samples; they sum to 1.
    """

    controls: Float[Tensor, "T U"]
    costs: Float[Tensor, " K"]
    weights: Float[Tensor, " K"]

    @property
    def cost(self) -> float:
        """Mean cost of the samples by their weights; samples of weight 0 do not count, even if not finite."""
        return float((self.weights * self.costs.where(self.weights > 0, 0.0)).sum())


@torch.no_grad()
def improve(
    controls: Float[Tensor, "T U"],
    cost_of: CostOf,
    settings: Settings,
    generator: Generator,
    *,
    previous: Float[Tensor, " U"] | None = None,
) -> Plan:
    """Improve a plan; deterministic for a state of the generator.

    Args:
        controls: initial plan, such as the last one after `shift`; its device and type are used throughout.
        generator: source of the noise, on the same device.
        previous: control before the first step, for limits of rates; None does not limit the first step.

    Raises:
        NoPlan: no sample has a finite cost.
    """
    for _ in range(settings.iterations):
        with single_threaded_torch():  # waking threads would take longer than this work
            samples = limited(sample(controls, settings, generator), settings, previous)
        costs = cost_of(samples).double()
        with single_threaded_torch():
            weights = weigh(costs, settings.temperature)
            controls = torch.einsum("k,ktu->tu", weights.to(samples.dtype), samples)
    controls = limited(controls[None], settings, previous)[0]  # rounding may leave the limits
    return Plan(controls, costs, weights)


def sample(controls: Float[Tensor, "T U"], settings: Settings, generator: Generator) -> Float[Tensor, "K T U"]:
    """Sample control sequences, before limits."""
    deviation = controls.new_tensor(settings.deviation)
    # As long as a sequence each, since torch is slow where inner axes are broadcast.
    scale, rest = (row.repeat(len(controls), 1) for row in (deviation, rest_of(settings, deviation)))
    samples = settings.noise((settings.samples, *controls.shape), generator, controls.dtype)
    for group in sample_groups(settings):
        part = samples[group.samples]
        torch.addcmul(rest if group.fresh else controls, part, group.factor * scale, out=part)
    return samples


def rest_of(settings: Settings, deviation: Float[Tensor, " U"]) -> Float[Tensor, " U"]:
    """Return the controls at rest, in the type and on the device of the deviations."""
    return torch.zeros_like(deviation) if settings.rest is None else deviation.new_tensor(settings.rest)


class SampleGroup(NamedTuple):
    """Samples of one distribution.

    Attributes:
        factor: factor on the noise.
        fresh: whether they lie around rest instead of the plan.
    """

    samples: slice
    factor: float
    fresh: bool


def sample_groups(settings: Settings) -> tuple[SampleGroup, ...]:
    """Return the groups of samples: the plan, rest, around rest, widely and narrowly around the plan."""
    fresh, wide = (1 + round(share * settings.samples) for share in (settings.fresh, settings.wide))
    return (
        SampleGroup(slice(0, 1), 0.0, fresh=False),
        SampleGroup(slice(1, min(2, fresh)), 0.0, fresh=True),
        SampleGroup(slice(2, fresh), settings.fresh_width, fresh=True),
        SampleGroup(slice(fresh, fresh + wide - 1), settings.width, fresh=False),
        SampleGroup(slice(fresh + wide - 1, None), 1.0, fresh=False),
    )


def limited(
    controls: Float[Tensor, "K T U"], settings: Settings, previous: Float[Tensor, " U"] | None = None
) -> Float[Tensor, "K T U"]:
    """Apply the limits of the settings (`controls.keep_within`)."""
    return keep_within(settings.limits, settings.dt, controls, previous)


def weigh(costs: Float[Tensor, " K"], temperature: float) -> Float[Tensor, " K"]:
    """Return weights proportional to exp(-cost / temperature) that sum to 1; 0 for non-finite costs.

    Raises:
        NoPlan: no cost is finite.
    """
    finite = costs.isfinite()
    if not finite.any():
        raise no_finite_cost(len(costs))
    # The least cost is subtracted first, since exp of large costs alone would underflow to 0.
    above = torch.where(finite, costs, torch.inf) - costs[finite].min()
    return torch.softmax(-above / temperature, dim=0)


def no_finite_cost(samples: int) -> NoPlan:
    """Return the error of a plan without finite costs."""
    how = "stop, and check start, map and cost for non-finite values"
    return NoPlan(f"none of {samples} sampled trajectories has a finite cost", how=how)


def shift(controls: Float[Tensor, "T U"], steps: int = 1) -> Float[Tensor, "T U"]:
    """Drop the first `steps` of a plan and hold its last control (warm start)."""
    steps = min(steps, len(controls))
    return torch.cat((controls[steps:], controls[-1:].expand(steps, -1)))
