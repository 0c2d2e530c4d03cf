"""Controls along a plan: a single pedal, throttle minus brake, from -1 to +1, the steering, and the gear that is held.

With two independent pedals a planner presses both at once: no training data show that, so the model's predictions of
it are wrong, and may be too good. Gears are not sampled: the run time chooses the gear of a plan, and models that know
one are given it here.
"""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.channels import OPTIONAL_CONTROLS
from offpiste.core.conventions import CONTROL
from offpiste.core.errors import PlanningError
from offpiste.dynamics.vehicle import Vehicle
from offpiste.planning.mppi import CostOf, Limits

PEDAL_AND_WHEEL: Final = Limits(low=(-1.0, -1.0), high=(1.0, 1.0), rate=(6.0, 4.0))
"""Bounds [1] and rates [1/s] of pedal and steer."""

COMPLETED: Final = (*CONTROL, *(control.name for control in OPTIONAL_CONTROLS))
"""Columns of controls with a gear."""


def controls_of(pedal_and_steer: Float[Tensor, "*P 2"]) -> Float[Tensor, "*P 3"]:
    """Throttle, brake and steer from pedal and steer."""
    pedal, steer = pedal_and_steer.unbind(-1)
    return torch.stack((pedal.clamp(min=0), (-pedal).clamp(min=0), steer), dim=-1)


def pedals_of(controls: Float[Tensor, "*P 3"]) -> Float[Tensor, "*P 2"]:
    """Pedal (throttle minus brake) and steer from throttle, brake and steer."""
    throttle, brake, steer = controls.unbind(-1)
    return torch.stack((throttle - brake, steer), dim=-1)


def with_pedal(cost_of: CostOf) -> CostOf:
    """Costs of sequences of pedal and steer [K, T, 2], from costs of throttle, brake and steer."""

    def cost(pedal_and_steer: Tensor) -> Tensor:
        return cost_of(controls_of(pedal_and_steer))

    return cost


def complete(
    vehicle: Vehicle, controls: Float[Tensor, "*P 3"] | Float[Tensor, "*P U"], gear: float | Float[Tensor, "*P 1"]
) -> Float[Tensor, "*P U"]:
    """Controls in the columns of a vehicle (`Vehicle.control_columns`).

    Args:
        controls: throttle, brake, steer; or all columns, which stay.
        gear: held throughout, or of each row.

    Raises:
        PlanningError: the vehicle has other controls than these and a gear.
    """
    columns, given = vehicle.control_columns, controls.shape[-1]
    if given == len(columns):
        return controls
    if given != len(CONTROL) or columns != COMPLETED:
        what = f"controls of {given} columns for a model of {', '.join(columns)}"
        raise PlanningError(what, how="plan throttle, brake and steer; a gear is held")
    return torch.cat((controls, gear * torch.ones_like(controls[..., :1])), dim=-1)
