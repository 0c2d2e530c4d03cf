"""What the physics and the networks read from a carry, with the reduced forms for channels that a log lacks."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import ACTUATORS, CONTROL
from offpiste.dynamics.vehicle import Vehicle
from offpiste.errors import DatasetError
from offpiste.geometry import rotate_by_minus_yaw
from offpiste.state import Terrain

REDUCED_ENGINE_SPEED = 10.0
"""Speed [m/s] that stands for 1 (1000 rev/min) where no engine speed is recorded."""


class DriveTrain(NamedTuple):
    """Inputs of the force vector, each [B]: throttle, brake, steer [rad], engine."""

    throttle: Tensor
    brake: Tensor
    steer: Tensor
    engine: Tensor


def drive_train(
    vehicle: Vehicle, state: Float[Tensor, "*B 6"], actuators: Float[Tensor, "*B 4"], control: Float[Tensor, "*B 3"]
) -> DriveTrain:
    """Throttle, brake, steering and engine as the bicycle reads them.

    Reduced forms: without brake pressure the brake command acts at once; without a steering angle the road wheels
    follow the command at once; without engine speed the polynomial P(x_rpm) reads |vx| / (10 m/s); without throttle or
    any brake signal the term is zero. The slot of an absent channel is never read.

    Raises:
        DatasetError: there is neither a steering angle nor a steering command.
    """
    commands = dict(zip(CONTROL, control.unbind(-1), strict=True))
    measured = dict(zip(ACTUATORS, actuators.unbind(-1), strict=True))
    nothing = torch.zeros_like(state[..., 0])
    if "steer" in vehicle.actuators:
        steer = measured["steer"]
    elif "steer" in vehicle.control:
        steer = vehicle.max_steer * commands["steer"]
    else:
        raise DatasetError("neither a steering angle nor a steering command", how="give one of them in the rig")
    if "brake" in vehicle.actuators:
        brake = measured["brake"]
    else:
        brake = commands["brake"] if "brake" in vehicle.control else nothing
    return DriveTrain(
        throttle=commands["throttle"] if "throttle" in vehicle.control else nothing,
        brake=brake,
        steer=steer,
        engine=measured["engine_rpm"]
        if "engine_rpm" in vehicle.actuators
        else state[..., 3].abs() / REDUCED_ENGINE_SPEED,
    )


def body_normal(terrain: Terrain, yaw: Float[Tensor, "*B"]) -> Float[Tensor, "*B 3"]:
    """The mean surface normal of the wheels, turned by minus yaw (eta of eq. 1)."""
    return rotate_by_minus_yaw(terrain.normal.mean(dim=-2), yaw)


def select_present(
    vehicle: Vehicle, actuators: Float[Tensor, "*B 4"], control: Float[Tensor, "*B 3"]
) -> Float[Tensor, "*B P"]:
    """The columns of actuators and control that the log has, in order; absent ones are not inputs at all."""
    kept_actuators = [i for i, name in enumerate(ACTUATORS) if name in vehicle.actuators]
    kept_control = [i for i, name in enumerate(CONTROL) if name in vehicle.control]
    return torch.cat((actuators[..., kept_actuators], control[..., kept_control]), dim=-1)
