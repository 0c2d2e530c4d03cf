"""Constraints on controls: bounds and rates."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.compilation import PLANNING, spread_kernel
from offpiste.core.channels import CONTROLS


@dataclass(frozen=True)
class Limits:
    """Bounds and rates, one number for each control.

    Attributes:
        low, high: bounds.
        rate: largest change per second; None for no limit.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    rate: tuple[float, ...] | None = None


PEDALS_AND_WHEEL = Limits(
    low=tuple(control.low for control in CONTROLS),
    high=tuple(control.high for control in CONTROLS),
    rate=tuple(control.rate for control in CONTROLS),
)
"""Limits of the controls in `offpiste.core.channels.CONTROLS`."""


def keep_within(
    limits: Limits, dt: float, controls: Float[Tensor, "K T U"], previous: Float[Tensor, " U"] | None = None
) -> Float[Tensor, "K T U"]:
    """Controls moved into bounds and rates, step after step, each as near to the given one as they allow.

    On the CPU one compiled pass, elsewhere `keep_within_stepwise`.

    Args:
        dt: duration of a step [s].
        previous: the control before the first step; None leaves that one free.
    """
    if limits.rate is None or controls.device.type != "cpu" or controls.dtype not in (torch.float32, torch.float64):
        return keep_within_stepwise(limits, dt, controls, previous)
    low, high, change = bounds(limits, dt, controls)
    first = torch.full_like(low, torch.nan) if previous is None else previous.to(low.dtype).clamp(low, high)
    kept = torch.empty(controls.shape, dtype=controls.dtype)
    arrays = (part.numpy() for part in (first, low, high, change))
    spread_kernel(len(controls), _walk, controls.detach().numpy(), *arrays, previous is None, kept.numpy())
    return kept


def keep_within_stepwise(
    limits: Limits, dt: float, controls: Float[Tensor, "K T U"], previous: Float[Tensor, " U"] | None = None
) -> Float[Tensor, "K T U"]:
    """Reference of `keep_within` in torch, step after step, on any device."""
    low, high, change = bounds(limits, dt, controls)
    controls = controls.clamp(low, high)
    if limits.rate is None:
        return controls
    steps = list(controls.unbind(dim=1))
    before = steps[0] if previous is None else previous.clamp(low, high)
    for t, wanted in enumerate(steps):
        before = steps[t] = torch.minimum(torch.maximum(wanted, before - change), before + change)
    return torch.stack(steps, dim=1)


def bounds(limits: Limits, dt: float, controls: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Low and high bounds, and the largest change in a step [U], in the type and on the device of controls."""
    low, high = controls.new_tensor(limits.low), controls.new_tensor(limits.high)
    change = torch.full_like(low, torch.inf) if limits.rate is None else controls.new_tensor(limits.rate) * dt
    return low, high, change


@PLANNING.entry
def _walk(
    first: int,
    last: int,
    controls: np.ndarray,
    previous: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    change: np.ndarray,
    free: bool,
    kept: np.ndarray,
) -> None:
    """Constrain samples `first` ... `last - 1`; NaN stays, and spreads to all later steps.

    Args:
        free: whether the first step is limited by bounds only.
    """
    _, steps, count = controls.shape
    before = np.empty_like(previous)
    for k in range(first, last):
        before[:] = previous
        for t in range(steps):
            for u in range(count):
                value, was = controls[k, t, u], before[u]
                value = low[u] if value < low[u] else value
                value = high[u] if value > high[u] else value
                if t > 0 or not free:
                    least, most = was - change[u], was + change[u]
                    value = least if value < least else value
                    value = most if value > most else value
                    value = value if was == was else was
                before[u] = value
                kept[k, t, u] = value
