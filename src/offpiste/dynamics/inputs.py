"""What the physics and the networks read from a model state, with the reduced forms for channels that a log lacks."""

from collections.abc import Callable
from typing import Final, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.channels import absent_value
from offpiste.core.errors import DatasetError
from offpiste.core.state import Terrain
from offpiste.dynamics.actuators import TORCH
from offpiste.dynamics.bicycle import Elementary, Scalar
from offpiste.dynamics.vehicle import Vehicle

REDUCED_ENGINE_SPEED = 10.0
"""Speed [m/s] that stands for 1 (1000 rev/min) where no engine speed is recorded."""


Commands = Callable[[str], Scalar]
"""The command of a control's name; `Control.absent` where the log has none."""


class DriveTrain(NamedTuple):
    """Inputs of the force vector, each [B]: throttle, brake, steer [rad], engine, gear."""

    throttle: Scalar
    brake: Scalar
    steer: Scalar
    engine: Scalar
    gear: Scalar


def reduced_throttle(commands: Commands, vx: Scalar, max_steer: Scalar, f: Elementary) -> Scalar:
    """Without its position, the throttle's command acts at once."""
    return commands("throttle")


def reduced_brake(commands: Commands, vx: Scalar, max_steer: Scalar, f: Elementary) -> Scalar:
    """Brake input of models without brake pressure: the command, without delay."""
    return commands("brake")


def reduced_steer(commands: Commands, vx: Scalar, max_steer: Scalar, f: Elementary) -> Scalar:
    """Without a steering angle, the road wheels follow the command at once [rad]."""
    return max_steer * commands("steer")


def reduced_engine(commands: Commands, vx: Scalar, max_steer: Scalar, f: Elementary) -> Scalar:
    """Without engine speed, the polynomial P(x_rpm) reads |vx| / (10 m/s)."""
    return f.maximum(vx, -vx) / REDUCED_ENGINE_SPEED


def reduced_gear(commands: Commands, vx: Scalar, max_steer: Scalar, f: Elementary) -> Scalar:
    """The gear as engaged; forward where the log has none."""
    return commands("gear")


REDUCED: Final = DriveTrain(reduced_throttle, reduced_brake, reduced_steer, reduced_engine, reduced_gear)
"""What stands for each input where no actuator measures it."""


def drive_train(
    vehicle: Vehicle, state: Float[Tensor, "*B 6"], actuators: Float[Tensor, "*B A"], control: Float[Tensor, "*B U"]
) -> DriveTrain:
    """Throttle, brake, steering, engine and gear as the bicycle reads them: measured, or else their reduced form.

    Without a throttle command, or any brake signal, that input is zero; without a gear it is forward. The slot of an
    absent channel is never read.

    Raises:
        DatasetError: there is neither a steering angle nor a steering command.
    """
    if not vehicle.steers:
        raise DatasetError("neither a steering angle nor a steering command", how="give one of them in the rig")
    measured = dict(zip(vehicle.actuator_columns, actuators.unbind(-1), strict=True))
    given = dict(zip(vehicle.control_columns, control.unbind(-1), strict=True))
    measures = vehicle.measured_inputs

    def commands(name: str) -> Tensor:
        return given[name] if name in vehicle.control else torch.full_like(state[..., 0], absent_value(name))

    return DriveTrain(
        *(
            measured[measures[name]] if name in measures else reduced(commands, state[..., 3], vehicle.max_steer, TORCH)
            for name, reduced in zip(DriveTrain._fields, REDUCED, strict=True)
        )
    )


def rotate_by_minus_yaw(vectors: Float[Tensor, "... 3"], yaw: Float[Tensor, "..."]) -> Float[Tensor, "... 3"]:
    """World vectors seen from a frame turned by `yaw` [rad] about z (the rotation that eq. 1's normals need)."""
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    x, y, z = vectors.unbind(-1)
    return torch.stack((cos * x + sin * y, cos * y - sin * x, z), dim=-1)


def body_normal(terrain: Terrain, yaw: Float[Tensor, "*B"]) -> Float[Tensor, "*B 3"]:
    """The mean surface normal of the wheels, turned by minus yaw (eta of eq. 1)."""
    return rotate_by_minus_yaw(terrain.normal.mean(dim=-2), yaw)


def unknown_normals(terrain: Terrain) -> Float[Tensor, "*B 1"]:
    """Share of the four wheels whose surface normal is unknown; straight up stands for those in `body_normal`."""
    return (~terrain.known).to(terrain.normal.dtype).mean(dim=-1, keepdim=True)


UNKNOWN: Final = 1
"""Numbers that `unknown_normals` gives."""


def select_present(
    vehicle: Vehicle, actuators: Float[Tensor, "*B A"], control: Float[Tensor, "*B U"]
) -> Float[Tensor, "*B P"]:
    """The columns of actuators and control that the log has, in order; absent ones are not inputs at all."""
    kept_actuators = [i for i, name in enumerate(vehicle.actuator_columns) if name in vehicle.actuators]
    kept_control = [i for i, name in enumerate(vehicle.control_columns) if name in vehicle.control]
    return torch.cat((actuators[..., kept_actuators], control[..., kept_control]), dim=-1)
