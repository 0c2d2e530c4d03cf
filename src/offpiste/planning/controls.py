"""Sampled controls: bounds, rates, and a single pedal in place of throttle and brake.

The single pedal is throttle minus brake, from -1 to +1. Two independent pedals would be pressed together, which does
not occur in training data. Gears are not sampled.
"""

from collections.abc import Callable
from ctypes import Structure, c_int, c_void_p
from dataclasses import dataclass
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.channels import CONTROLS, OPTIONAL_CONTROLS
from offpiste.core.conventions import CONTROL
from offpiste.core.errors import PlanningError
from offpiste.dynamics.vehicle import Vehicle
from offpiste.native.library import library
from offpiste.native.tensors import CHUNK, Arrays, call


@dataclass(frozen=True)
class Limits:
    """Bounds and rates of controls.

    Attributes:
        rate: largest change per second; None for no limit.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    rate: tuple[float, ...] | None = None


CONTROL_LIMITS: Final = Limits(
    low=tuple(control.low for control in CONTROLS),
    high=tuple(control.high for control in CONTROLS),
    rate=tuple(control.rate for control in CONTROLS),
)
"""Limits of throttle, brake and steer."""

PEDAL_LIMITS: Final = Limits(low=(-1.0, -1.0), high=(1.0, 1.0), rate=(6.0, 4.0))
"""Limits of pedal and steer; rates in 1/s."""

COMPLETED: Final = (*CONTROL, *(control.name for control in OPTIONAL_CONTROLS))
"""Columns of controls of models with a gear."""


def controls_of(pedal_and_steer: Float[Tensor, "*P 2"]) -> Float[Tensor, "*P 3"]:
    """Convert pedal and steer to throttle, brake and steer."""
    pedal, steer = pedal_and_steer.unbind(-1)
    return torch.stack((pedal.clamp(min=0), (-pedal).clamp(min=0), steer), dim=-1)


def pedals_of(controls: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 2"]:
    """Convert throttle, brake and steer to pedal (throttle minus brake) and steer."""
    throttle, brake, steer = controls.unbind(-1)
    return torch.stack((throttle - brake, steer), dim=-1)


class _Bounds(Structure):
    _fields_ = (
        *((name, c_void_p) for name in ("previous", "low", "high", "change")),
        *((name, c_int) for name in ("count", "steps", "columns", "free")),
    )


def with_pedal(cost_of: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """Return a function of pedal and steer [K, T, 2] from a function of throttle, brake and steer."""
    return lambda pedal_and_steer: cost_of(controls_of(pedal_and_steer))


def complete(
    vehicle: Vehicle, controls: Float[Tensor, "*P 3"] | Float[Tensor, "*P U"], gear: float | Float[Tensor, "*P 1"]
) -> Float[Tensor, "*P U"]:
    """Return controls in the columns of a vehicle (`Vehicle.control_columns`).

    Args:
        controls: throttle, brake and steer, or all columns, which are returned unchanged.
        gear: common gear, or the gear of each row.

    Raises:
        PlanningError: the vehicle has other controls.
    """
    columns, given = vehicle.control_columns, controls.shape[-1]
    if given == len(columns):
        return controls
    if given != len(CONTROL) or columns != COMPLETED:
        what = f"{given} columns of controls do not fit a model with {', '.join(columns)}"
        raise PlanningError(what, how="plan throttle, brake and steer; a gear is held")
    return torch.cat((controls, gear * torch.ones_like(controls[..., :1])), dim=-1)


def keep_within(
    limits: Limits, dt: float, controls: Float[Tensor, "K T U"], previous: Float[Tensor, " U"] | None = None
) -> Float[Tensor, "K T U"]:
    """Clip controls step by step to bounds and rates; `keep_within_stepwise`, compiled for float32 on the CPU.

    Args:
        dt: duration of a step [s].
        previous: control before the first step; None does not limit the first step.

    Raises:
        ValueError: a shape does not fit the limits.
    """
    columns = (len(limits.low),)
    if controls.shape[2:] != columns or (previous is not None and previous.shape != columns):
        before = "" if previous is None else f", the control before {list(previous.shape)}"
        raise ValueError(f"controls have shape {list(controls.shape)}{before}, not [K, T, {columns[0]}]")
    fast = controls.device.type == "cpu" and controls.dtype == torch.float32 and library() is not None
    if limits.rate is None or not fast:
        return keep_within_stepwise(limits, dt, controls, previous)
    low, high, change = bounds(limits, dt, controls)
    first = torch.full_like(low, torch.nan) if previous is None else previous.to(low.dtype).clamp(low, high)
    arrays, kept = Arrays(), controls.new_empty(controls.shape)
    given = _Bounds(*map(arrays.floats, (first, low, high, change)), *controls.shape, previous is None)
    call("keep_within", -(-len(controls) // CHUNK), given, controls.detach().contiguous(), kept)
    return kept


def keep_within_stepwise(
    limits: Limits, dt: float, controls: Float[Tensor, "K T U"], previous: Float[Tensor, " U"] | None = None
) -> Float[Tensor, "K T U"]:
    """Clip controls as `keep_within`, in torch on any device."""
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
    """Return low and high bounds and the largest change per step [U], in the type and on the device of controls."""
    low, high = controls.new_tensor(limits.low), controls.new_tensor(limits.high)
    change = torch.full_like(low, torch.inf) if limits.rate is None else controls.new_tensor(limits.rate) * dt
    return low, high, change
