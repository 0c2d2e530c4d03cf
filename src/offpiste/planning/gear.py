"""Gear along a plan: sampled controls are throttle, brake and steer; models that know a gear are given the held one.

This is the one place that completes controls. Gears are not sampled: the run time chooses the gear of a plan.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.channels import OPTIONAL_CONTROLS
from offpiste.conventions import CONTROL
from offpiste.dynamics.vehicle import Vehicle
from offpiste.errors import PlanningError

COMPLETED = (*CONTROL, *(control.name for control in OPTIONAL_CONTROLS))


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
