"""The physics of the parametric bicycle, once, as functions of plain scalars (paper, eqs. 1-4).

The elementary functions are passed in: with torch's the functions below are the reference on batches, with SymPy's they
are expressions from which kernels are derived. docs/method.md lists what differs from the paper as printed, and why.

The learned constants are bounded by construction to what physics and the stability of forward Euler allow.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from offpiste.core.conventions import DT, GRAVITY
from offpiste.dynamics.vehicle import Vehicle

Scalar = Any
"""A number, a tensor of any shape, or a symbol."""


class Elementary(NamedTuple):
    """Elementary functions that the physics is written with."""

    sin: Callable[[Scalar], Scalar]
    cos: Callable[[Scalar], Scalar]
    tanh: Callable[[Scalar], Scalar]
    atan: Callable[[Scalar], Scalar]
    maximum: Callable[[Scalar, Scalar], Scalar]


class Constants(NamedTuple):
    """Constants of eqs. 1-4 after their constraints (`offpiste.dynamics.bicycle`), forces in N.

    Attributes:
        drive_1, drive_2: P(u_th) = drive_1 u + drive_2 u^2, >= 0 and rising on [0, 1] [N].
        engine_1, engine_2: P(x_rpm) = 1 + engine_1 x + engine_2 x^2, cut at 0, x in 1000 rev/min (or 10 m/s, reduced).
        brake_1, brake_2: P(x_br) = brake_1 x + brake_2 x^2, >= 0 [N]; pressure below zero counts as zero.
        resistance, resistance_slope: beta(vx) = resistance tanh(resistance_slope vx) [N, s/m].
        rear_peak, rear_shape, rear_stiffness: D_R > 0 [N], 0 < C_R < 3 pi / 4, B_R > 0.
        front_peak, front_shape, front_stiffness: D_F, C_F, B_F.
        rear_length, front_length: L_R, L_F > 0: pose point to axle [m].
        min_slip_speed: C_max [m/s], bounded below for Euler's sake.
        yaw_gain: C_r / C_L [1/(m s)]: only the ratio can be identified.
        yaw_damping: C_{r,d} [1/s].
        drag_x, drag_y: C_{x,d}, C_{y,d} >= 0 [1/m].
        gravity_x, gravity_y: C_{x,g}, C_{y,g} > 0 [m/s^2].
        mass: m, from the rig [kg].
    """

    drive_1: Scalar
    drive_2: Scalar
    engine_1: Scalar
    engine_2: Scalar
    brake_1: Scalar
    brake_2: Scalar
    resistance: Scalar
    resistance_slope: Scalar
    rear_peak: Scalar
    rear_shape: Scalar
    rear_stiffness: Scalar
    front_peak: Scalar
    front_shape: Scalar
    front_stiffness: Scalar
    rear_length: Scalar
    front_length: Scalar
    min_slip_speed: Scalar
    yaw_gain: Scalar
    yaw_damping: Scalar
    drag_x: Scalar
    drag_y: Scalar
    gravity_x: Scalar
    gravity_y: Scalar
    mass: Scalar


class Force(NamedTuple):
    """The vector F of eq. 1: forward and lateral tyre forces [N], yaw acceleration [rad/s^2]."""

    forward: Scalar
    lateral_front: Scalar
    lateral_rear: Scalar
    yaw: Scalar


class Rates(NamedTuple):
    """Time derivatives of the state (eq. 4): m/s, m/s, rad/s, m/s^2, m/s^2, rad/s^2."""

    px: Scalar
    py: Scalar
    yaw: Scalar
    vx: Scalar
    vy: Scalar
    yaw_rate: Scalar


STANDSTILL = 0.25
"""Below about this speed [m/s] forces that oppose motion fade out (their tanh(vx / STANDSTILL))."""


def slip_angles(
    vx: Scalar, vy: Scalar, yaw_rate: Scalar, steer: Scalar, c: Constants, f: Elementary
) -> tuple[Scalar, Scalar]:
    """Slip angles of the rear and the front tyre [rad] (eqs. 2-3).

    |vx| for vx, and below C_max a steering term in proportion to vx: as printed, a parked car with turned wheels drives
    off. Below C_max all of the slip then fades alike, so that it stays zero where the front axle moves the way its
    wheels point; a steering term that fades slower or faster than that turns a slow car too little, or propels it.
    """
    forward = f.maximum(f.maximum(vx, -vx), c.min_slip_speed)
    rear = f.atan((vy - c.rear_length * yaw_rate) / forward)
    front = f.atan((vy + c.front_length * yaw_rate) / forward) - steer * (vx / forward)
    return rear, front


def forces(
    vx: Scalar,
    vy: Scalar,
    yaw_rate: Scalar,
    brake: Scalar,
    steer: Scalar,
    engine: Scalar,
    throttle: Scalar,
    gear: Scalar,
    normal_z: Scalar,
    c: Constants,
    f: Elementary,
) -> Force:
    """The force vector F (eq. 1).

    Args:
        vx, vy: body velocity [m/s].
        yaw_rate: [rad/s].
        brake: x_br, brake pressure [0..1].
        steer: delta, road-wheel angle, + left [rad].
        engine: x_rpm [1000 rev/min], or its reduced form (`offpiste.dynamics.inputs`).
        throttle: u_th [0..1].
        gear: u_g: 1 forward, 0 neutral, -1 reverse.
        normal_z: eta_z, vertical part of the mean surface normal.
    """
    rear_slip, front_slip = slip_angles(vx, vy, yaw_rate, steer, c, f)
    # Cut at zero: throttle must not brake at high engine speed, nor a learned residual's negative pressure push.
    torque = f.maximum(1 + c.engine_1 * engine + c.engine_2 * engine * engine, 0 * engine)
    brake = f.maximum(brake, 0 * brake)
    drive = torque * (c.drive_1 * throttle + c.drive_2 * throttle * throttle)
    braking = (c.brake_1 * brake + c.brake_2 * brake * brake) * f.tanh(vx / STANDSTILL)
    rolling = c.resistance * f.tanh(c.resistance_slope * vx)
    return Force(
        forward=(gear * drive - braking - rolling) * normal_z,
        lateral_front=-c.front_peak * f.sin(c.front_shape * f.tanh(c.front_stiffness * front_slip)) * normal_z,
        lateral_rear=-c.rear_peak * f.sin(c.rear_shape * f.tanh(c.rear_stiffness * rear_slip)) * normal_z,
        yaw=c.yaw_gain * vx * steer - c.yaw_damping * yaw_rate,
    )


def rates(
    yaw: Scalar,
    vx: Scalar,
    vy: Scalar,
    yaw_rate: Scalar,
    steer: Scalar,
    normal_x: Scalar,
    normal_y: Scalar,
    force: Force,
    c: Constants,
    f: Elementary,
) -> Rates:
    """h(F, x): from forces to the derivatives of the state (eq. 4).

    Args:
        normal_x, normal_y: eta_x, eta_y of the mean surface normal in the planar body frame; the normal tilts back when
            the nose goes up, so gravity enters with a plus.
    """
    sin_steer, cos_steer = f.sin(steer), f.cos(steer)
    sin_yaw, cos_yaw = f.sin(yaw), f.cos(yaw)
    speed_x, speed_y = f.maximum(vx, -vx), f.maximum(vy, -vy)
    return Rates(
        px=cos_yaw * vx - sin_yaw * vy,
        py=sin_yaw * vx + cos_yaw * vy,
        yaw=yaw_rate,
        vx=((1 + cos_steer) * force.forward - force.lateral_front * sin_steer) / c.mass
        - c.drag_x * vx * speed_x
        + c.gravity_x * normal_x
        + vy * yaw_rate,
        vy=(force.lateral_rear + cos_steer * force.lateral_front + force.forward * sin_steer) / c.mass
        - c.drag_y * vy * speed_y
        + c.gravity_y * normal_y
        - vx * yaw_rate,
        yaw_rate=force.yaw,
    )


class Range(NamedTuple):
    """An open interval and where learning begins in it."""

    low: float
    high: float
    initial: float


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
    # An axle carries less than the whole weight and grips with less than its load; a tyre that slides keeps at least
    # sin(C) = 0.7 of its peak.
    "rear_peak": Range(0, GRAVITY, 4),
    "rear_shape": Range(0, 2.35, 1.3),
    "rear_stiffness": Range(0, 20, 3),
    "front_peak": Range(0, GRAVITY, 4),
    "front_shape": Range(0, 2.35, 1.3),
    "front_stiffness": Range(0, 20, 3),
    # In wheelbases: the pose point lies between the axles.
    "rear_length": Range(0, 1, 0.5),
    "front_length": Range(0, 1, 0.5),
    # In units of the bound below which Euler at DT is unstable.
    "min_slip_speed": Range(1, 4, 2),
    # Yaw gain over its steady value vx delta / wheelbase, above 1 where the rig's largest angle is too small; damping
    # in 1/s.
    "yaw_understeer": Range(0, 1.5, 0.9),
    "yaw_damping": Range(0.2, 40, 5),
    # Air alone is about 0.003 /m: density, drag area and mass of the vehicle give 1.2 c_d A / (2 m).
    "drag_x": Range(0, 0.05, 0.005),
    "drag_y": Range(0, 0.05, 0.005),
    # Gravity itself, and a tenth for slopes that the map or the path smooths; noise in the slopes makes it less.
    "gravity_x": Range(0, 1.1 * GRAVITY, GRAVITY),
    "gravity_y": Range(0, 1.1 * GRAVITY, GRAVITY),
}


class BicycleConstants(nn.Module):
    """Unconstrained parameters -> `Constants`, through a sigmoid into each constant's interval.

    Signs: tyre peaks and stiffnesses are positive and shapes below 3 pi / 4, so tyre force opposes slip at every angle;
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
