"""Model predictive path integral control (MPPI): the mean of sampled control sequences, weighted by their costs.

After Williams, Drews, Goldfain, Rehg and Theodorou, "Information-theoretic model predictive control" (T-RO 2018,
algorithm 2), with the low-frequency noise of Vlahov et al. (RA-L 2024). Costs of control sequences come from a function
(`rollouts`, `kernel`); nothing here depends on what it does.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from scipy.signal import savgol_coeffs
from torch import Generator, Tensor

from offpiste.core.conventions import DT
from offpiste.core.errors import NoPlan
from offpiste.native.compilation import single_threaded_torch
from offpiste.planning.controls import PEDALS_AND_WHEEL, Limits, keep_within
from offpiste.planning.noise import Noise, coloured, covariance

__all__ = ["PEDALS_AND_WHEEL", "CostOf", "Limits", "Plan", "Settings", "improve", "limited", "sample", "shift"]

CostOf = Callable[[Tensor], Tensor]
"""Costs [K] of control sequences [K, T, U]; a sequence whose cost is not finite has no weight."""


@dataclass(frozen=True)
class Settings:
    """Settings of the planner.

    Attributes:
        limits: bounds and rates of the controls.
        deviation: standard deviation of the noise of each control.
        samples: K, the first of which is the plan itself.
        temperature: lambda [cost]; samples that cost much more than this above the best hardly count.
        iterations: number of times to sample and average.
        noise: unit noise (`planning.noise`).
        wide, width: share of samples whose noise is `width` times as large.
        fresh: share of samples around `rest` instead of the plan; the first of them is `rest` without noise.
        fresh_width: factor of the noise of the other fresh samples; a way out may be far from rest.
        rest: controls at rest; zeros if None.
        control_cost: gamma, weight of u' Sigma^-1 (v - u) (`control_costs`); `temperature` for plans that do not depend
            on the plan so far (Williams et al., eq. 18), 0 for costs alone.
        smoothing: odd length of a Savitzky-Golay filter of third order over the plan [steps]; 0 for none.
        dt: duration of a step [s], for the rates.

    Raises:
        ValueError: a number is out of range; `smoothing` is even; or a control cost with noise whose covariance is not
            known.
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
    control_cost: float = 0.0
    smoothing: int = 0
    dt: float = DT

    def __post_init__(self) -> None:
        if min(self.samples, self.iterations) < 1:
            raise ValueError(f"{self.samples} samples and {self.iterations} iterations; each has to be 1 or more")
        if not (0 < self.temperature < math.inf and 0 < self.dt < math.inf):
            raise ValueError(f"a temperature of {self.temperature:g} and steps of {self.dt:g} s; both are above 0")
        if min(self.fresh, self.wide) < 0 or self.fresh + self.wide > 1:
            raise ValueError(f"shares of {self.fresh:g} fresh and {self.wide:g} wide samples; together at most 1")
        if self.smoothing < 0:
            raise ValueError(f"smoothing over {self.smoothing} steps; it has to be 0 or more")
        if self.smoothing and self.smoothing % 2 == 0:
            raise ValueError(f"smoothing over {self.smoothing} steps; it has to be odd")
        if self.control_cost:
            try:
                covariance(self.noise, 2)
            except ValueError as error:
                raise ValueError(f"control_cost needs the covariance of the noise: {error}") from None


@dataclass(frozen=True)
class Plan:
    """The outcome of planning.

    Attributes:
        controls: control of each step.
        costs: costs of the last iteration's samples; the first sample is the plan before that iteration.
        weights: weights of the same samples; they sum to 1.
    """

    controls: Float[Tensor, "T U"]
    costs: Float[Tensor, " K"]
    weights: Float[Tensor, " K"]

    @property
    def effective_samples(self) -> float:
        """Effective number of samples, 1 / sum of squared weights: from 1, if one has all weight, to K."""
        return 1 / float(self.weights.square().sum())

    @property
    def cost(self) -> float:
        """Mean cost of the samples by their weights."""
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
    """Improve a plan; deterministic for a generator's state.

    Args:
        controls: the plan so far, e.g. the last one after `shift`; its device and type are used throughout.
        generator: source of the noise, on the same device.
        previous: control before the first step, where limits of rates start.

    Raises:
        NoPlan: no sample has a finite cost.
    """
    for _ in range(settings.iterations):
        with single_threaded_torch():  # threads that are woken for so little spin for longer than it takes
            draws = sample(controls, settings, generator)
            samples = limited(draws, settings, previous)
        costs = cost_of(samples).double()
        with single_threaded_torch():
            costs += control_costs(draws, controls, settings)
            weights = weigh(costs, settings.temperature)
            controls = torch.einsum("k,ktu->tu", weights.to(samples.dtype), samples)
    # A mean of sequences within limits is within them, up to rounding; smoothing may leave them.
    controls = limited(smoothed(controls, settings.smoothing)[None], settings, previous)[0]
    return Plan(controls, costs, weights)


def sample(controls: Float[Tensor, "T U"], settings: Settings, generator: Generator) -> Float[Tensor, "K T U"]:
    """Sampled sequences: the plan itself, then around rest, widely around the plan, and narrowly around it."""
    deviation = controls.new_tensor(settings.deviation)
    rest = rest_of(settings, deviation)
    samples = settings.noise((settings.samples, *controls.shape), generator, controls.dtype) * deviation
    for group in sample_groups(settings):
        part = samples[group.samples]
        if group.factor != 1:
            part *= group.factor
        part += rest if group.fresh else controls
    return samples


def rest_of(settings: Settings, deviation: Float[Tensor, " U"]) -> Float[Tensor, " U"]:
    """Controls at rest, in the type and on the device of the deviations."""
    return torch.zeros_like(deviation) if settings.rest is None else deviation.new_tensor(settings.rest)


class SampleGroup(NamedTuple):
    """Samples that are drawn alike.

    Attributes:
        samples: which ones.
        factor: of the noise.
        fresh: whether they lie around rest, not around the plan.
    """

    samples: slice
    factor: float
    fresh: bool


def sample_groups(settings: Settings) -> tuple[SampleGroup, ...]:
    """All samples: the plan, rest, around rest, widely around the plan, and narrowly around it."""
    fresh, wide = _fresh_and_wide(settings)
    return (
        SampleGroup(slice(0, 1), 0.0, fresh=False),
        SampleGroup(slice(1, min(2, fresh.stop)), 0.0, fresh=True),
        SampleGroup(slice(2, fresh.stop), settings.fresh_width, fresh=True),
        SampleGroup(wide, settings.width, fresh=False),
        SampleGroup(slice(wide.stop, None), 1.0, fresh=False),
    )


def _fresh_and_wide(settings: Settings) -> tuple[slice, slice]:
    """Which samples are fresh, and which are wide; the first one and those behind them are neither."""
    fresh, wide = (1 + round(share * settings.samples) for share in (settings.fresh, settings.wide))
    return slice(1, fresh), slice(fresh, fresh + wide - 1)


def limited(
    controls: Float[Tensor, "K T U"], settings: Settings, previous: Float[Tensor, " U"] | None = None
) -> Float[Tensor, "K T U"]:
    """Controls moved into the limits of the settings (`controls.keep_within`).

    Args:
        previous: the control before the first step; None leaves that one free.
    """
    return keep_within(settings.limits, settings.dt, controls, previous)


def control_costs(
    draws: Float[Tensor, "K T U"], controls: Float[Tensor, "T U"], settings: Settings
) -> Float[Tensor, " K"]:
    """Control costs gamma u' Sigma^-1 (v - u), with the covariance Sigma of the noise over all steps.

    exp(-cost / lambda) is the ratio of two densities: that of noise about (1 - gamma / lambda) u, to that of the noise
    about u that was drawn. Wide samples have their own, larger Sigma. Fresh ones do not lie about u, and cost nothing.
    Each group's ratios are divided by their mean, which is 1 but for chance: so shares stay as they are set.

    Args:
        draws: before limits; after them the noise is no longer Gaussian.
        controls: u, the plan that was sampled around.
    """
    if settings.control_cost == 0:
        return draws.new_zeros(len(draws), dtype=torch.float64)
    plan, deviation = controls.double(), controls.new_tensor(settings.deviation).double()
    sigma = covariance(settings.noise, len(plan)).to(plan.device)
    scaled = torch.cholesky_solve(plan / deviation.square(), torch.linalg.cholesky(sigma))
    costs = settings.control_cost * torch.einsum("ktu,tu->k", draws.double() - plan, scaled)
    fresh, wide = _fresh_and_wide(settings)
    costs[fresh] = 0
    costs[wide] /= settings.width**2
    for group in ([0, *range(wide.stop, len(costs))], wide):
        if len(own := costs[group]):
            mean = torch.logsumexp(-own / settings.temperature, dim=0) - math.log(len(own))
            costs[group] = own + settings.temperature * mean
    return costs


def weigh(costs: Float[Tensor, " K"], temperature: float) -> Float[Tensor, " K"]:
    """Weights exp(-cost / temperature), scaled to sum to 1; 0 where the cost is not finite.

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
    """What is wrong where no sample can be weighed."""
    how = "stop, and check start, map and cost for values that are not finite"
    return NoPlan(f"none of {samples} sampled trajectories has a finite cost", how=how)


def smoothed(controls: Float[Tensor, "T U"], window: int) -> Float[Tensor, "T U"]:
    """Plan smoothed by a Savitzky-Golay filter of third order, as Williams et al. use; the ends are held."""
    if window <= 3:
        return controls
    kernel = torch.as_tensor(savgol_coeffs(window, 3).copy(), dtype=controls.dtype, device=controls.device)
    half = window // 2
    padded = torch.cat((controls[:1].expand(half, -1), controls, controls[-1:].expand(half, -1)))
    return torch.nn.functional.conv1d(padded.T[:, None], kernel.flip(0)[None, None])[:, 0].T


def shift(controls: Float[Tensor, "T U"], steps: int = 1) -> Float[Tensor, "T U"]:
    """Rest of a plan after `steps` of it were driven, its last control held (warm start)."""
    steps = min(steps, len(controls))
    return torch.cat((controls[steps:], controls[-1:].expand(steps, -1)))
