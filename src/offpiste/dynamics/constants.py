"""Learned constants of the bicycle, kept by construction where physics and Euler's stability want them."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from offpiste.conventions import DT, GRAVITY
from offpiste.dynamics.base import Vehicle
from offpiste.dynamics.bicycle import STANDSTILL, Constants


class Range(NamedTuple):
    """An open interval and where learning begins in it."""

    low: float
    high: float
    initial: float


_HALF_PI = 1.5707963267948966

_RANGES: dict[str, Range] = {
    # Accelerations in m/s^2; forces act at both axles, hence their halves.
    "drive_1": Range(0, 10, 1.5),
    "drive_bend": Range(0, 10, 0.75),
    "engine_1": Range(-1, 1, 0),
    "engine_2": Range(-0.5, 0.5, 0),
    "brake_1": Range(0, 4, 0.5),
    "brake_2": Range(0, 4, 0.5),
    "resistance": Range(0, 2.5, 0.3),
    "resistance_slope": Range(0, 1 / STANDSTILL, 1),
    "rear_peak": Range(0, 15, 4),
    "rear_shape": Range(0, 2 * _HALF_PI, 1.3),
    "rear_stiffness": Range(0, 20, 3),
    "front_peak": Range(0, 15, 4),
    "front_shape": Range(0, 2 * _HALF_PI, 1.3),
    "front_stiffness": Range(0, 20, 3),
    # In wheelbases.
    "rear_length": Range(0, 1.5, 0.5),
    "front_length": Range(0, 1.5, 0.5),
    # In units of the bound below which Euler at DT is unstable.
    "min_slip_speed": Range(1, 20, 2),
    # Yaw gain over its steady value vx delta / wheelbase; damping in 1/s.
    "yaw_understeer": Range(0, 3, 0.9),
    "yaw_damping": Range(0.2, 40, 5),
    "drag_x": Range(0, 0.5, 0.005),
    "drag_y": Range(0, 0.5, 0.005),
    "gravity_x": Range(0, 2 * GRAVITY, GRAVITY),
    "gravity_y": Range(0, 2 * GRAVITY, GRAVITY),
}


class BicycleConstants(nn.Module):
    """Unconstrained parameters -> `Constants`, through a sigmoid into each constant's interval.

    Signs: tyre peaks and stiffnesses are positive and shapes below pi, so tyre force opposes slip at every angle;
    brakes, rolling resistance and drag are positive; drive is positive and rises with throttle; gravity is positive.
    Energy: the yaw rate follows the steering, not the tyres' moments, so a front axle that turns faster than its wheels
    point would push the vehicle forward for ever. Both axles' distances are therefore shortened together until
    understeer (L_R + L_F) is at most the wheelbase, the geometry of rolling without slip.
    Stability: C_max is at least dt (D_F C_F B_F + D_R C_R B_R) / m, half of where forward Euler becomes unstable.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self.mass, self.wheelbase = vehicle.mass, vehicle.wheelbase
        ranges = list(_RANGES.values())
        low, high, initial = (torch.tensor(column, dtype=torch.float64) for column in zip(*ranges, strict=True))
        self.low: Tensor
        self.width: Tensor
        self.register_buffer("low", low.float(), persistent=False)
        self.register_buffer("width", (high - low).float(), persistent=False)
        self.raw = nn.Parameter(torch.logit((initial - low) / (high - low)).float())

    def forward(self) -> Constants:
        """The constants, each a scalar tensor."""
        scaled = self.low + self.width * torch.sigmoid(self.raw)
        u = dict(zip(_RANGES, scaled.unbind(), strict=True))
        m, wheelbase = self.mass, self.wheelbase
        slope = (
            u["rear_peak"] * u["rear_shape"] * u["rear_stiffness"]
            + u["front_peak"] * u["front_shape"] * u["front_stiffness"]
        )
        reach = wheelbase / torch.clamp(u["yaw_understeer"] * (u["rear_length"] + u["front_length"]), min=1.0)
        return Constants(
            drive_1=m * u["drive_1"],
            drive_2=m * (u["drive_bend"] - u["drive_1"] / 2),
            engine_1=u["engine_1"],
            engine_2=u["engine_2"],
            brake_1=m * u["brake_1"],
            brake_2=m * u["brake_2"],
            resistance=m * u["resistance"],
            resistance_slope=u["resistance_slope"],
            rear_peak=m * u["rear_peak"],
            rear_shape=u["rear_shape"],
            rear_stiffness=u["rear_stiffness"],
            front_peak=m * u["front_peak"],
            front_shape=u["front_shape"],
            front_stiffness=u["front_stiffness"],
            rear_length=reach * u["rear_length"],
            front_length=reach * u["front_length"],
            min_slip_speed=u["min_slip_speed"] * DT * slope,
            yaw_gain=u["yaw_understeer"] * u["yaw_damping"] / wheelbase,
            yaw_damping=u["yaw_damping"],
            drag_x=u["drag_x"],
            drag_y=u["drag_y"],
            gravity_x=u["gravity_x"],
            gravity_y=u["gravity_y"],
            mass=torch.as_tensor(m, dtype=self.raw.dtype, device=self.raw.device),
        )
