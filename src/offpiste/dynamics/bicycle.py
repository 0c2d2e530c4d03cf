"""Physics of the parametric bicycle as functions of plain scalars (paper, eqs. 1-4).

The elementary functions are arguments: torch's evaluate the physics on batches (`offpiste.dynamics.torch_physics`),
SymPy's yield the expressions that kernels are derived from. docs/method.md explains deviations from the printed
equations.
"""

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from offpiste.core.conventions import DT, GRAVITY

Scalar = Any
"""Number, tensor of any shape, or symbol."""


class Elementary(NamedTuple):
    """Elementary math functions used by the vehicle model."""

    sin: Callable[[Scalar], Scalar]
    cos: Callable[[Scalar], Scalar]
    tanh: Callable[[Scalar], Scalar]
    atan: Callable[[Scalar], Scalar]
    maximum: Callable[[Scalar, Scalar], Scalar]


class Constants(NamedTuple):
    """Constants of eqs. 1-4 after `constrained`.

    Attributes:
        drive_1, drive_2: P(u_th) = drive_1 u + drive_2 u^2, >= 0 and increasing on [0, 1] [N].
        engine_1, engine_2: P(x_rpm) = 1 + engine_1 x + engine_2 x^2, at least 0; x in 1000 rev/min (reduced: 10 m/s).
        brake_1, brake_2: P(x_br) = brake_1 x + brake_2 x^2, >= 0 [N]; negative pressure counts as zero.
        resistance, resistance_slope: beta(vx) = resistance tanh(resistance_slope vx) [N, s/m].
        rear_peak, rear_shape, rear_stiffness: D_R > 0 [N], 0 < C_R < 3 pi / 4, B_R > 0.
        front_peak, front_shape, front_stiffness: D_F, C_F, B_F.
        rear_length, front_length: L_R, L_F > 0: pose point to axle [m].
        min_slip_speed: C_max [m/s], bounded below for the stability of forward Euler.
        yaw_gain: C_r / C_L [1/(m s)]: only the ratio is identifiable.
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
    """Vector F of eq. 1: forward and lateral tyre forces [N], yaw acceleration [rad/s^2]."""

    forward: Scalar
    lateral_front: Scalar
    lateral_rear: Scalar
    yaw: Scalar


class Rates(NamedTuple):
    """Time derivatives of the state (eq. 4) [m/s, m/s, rad/s, m/s^2, m/s^2, rad/s^2]."""

    px: Scalar
    py: Scalar
    yaw: Scalar
    vx: Scalar
    vy: Scalar
    yaw_rate: Scalar


Commands = Callable[[str], Scalar]
"""Command of a control by its name; `Control.absent` if the log lacks it."""


class DriveTrain(NamedTuple):
    """Inputs of the force vector.

    Attributes:
        throttle: u_th [0..1].
        brake: brake pressure x_br [0..1].
        steer: road-wheel angle delta, positive left [rad].
        engine: engine speed x_rpm [1000 rev/min], or its reduced form.
        gear: u_g: 1 forward, 0 neutral, -1 reverse.
    """

    throttle: Scalar
    brake: Scalar
    steer: Scalar
    engine: Scalar
    gear: Scalar


REDUCED_ENGINE_SPEED: Final = 10.0
"""Speed equivalent to 1000 rev/min if no engine speed is recorded [m/s]."""


def reduced_inputs(commands: Commands, vx: Scalar, max_steer: Scalar, f: Elementary) -> DriveTrain:
    """Return the inputs if no actuator is measured: commands act at once, engine speed is proportional to |vx|."""
    return DriveTrain(
        throttle=commands("throttle"),
        brake=commands("brake"),
        steer=max_steer * commands("steer"),
        engine=f.maximum(vx, -vx) / REDUCED_ENGINE_SPEED,
        gear=commands("gear"),
    )


def body_normal(x: Scalar, y: Scalar, z: Scalar, yaw: Scalar, f: Elementary) -> tuple[Scalar, Scalar, Scalar]:
    """Return a surface normal of the world frame in the planar body frame (eta of eq. 1)."""
    cos, sin = f.cos(yaw), f.sin(yaw)
    return cos * x + sin * y, cos * y - sin * x, z


STANDSTILL: Final = 0.25
"""Speed below which forces that oppose motion fade out, by tanh(vx / STANDSTILL) [m/s]."""


def slip_angles(
    vx: Scalar, vy: Scalar, yaw_rate: Scalar, steer: Scalar, c: Constants, f: Elementary
) -> tuple[Scalar, Scalar]:
    """Return the slip angles of the rear and the front tyre [rad] (eqs. 2-3).

    Unlike the printed equations, |vx| replaces vx, and the steering term is proportional to vx below C_max: as printed,
    a parked car with turned wheels drives off. All slip thus fades alike and stays zero where the front axle moves in
    the direction of its wheels. A steering term that fades differently under-steers or propels a slow car.
    """
    forward = f.maximum(f.maximum(vx, -vx), c.min_slip_speed)
    rear = f.atan((vy - c.rear_length * yaw_rate) / forward)
    front = f.atan((vy + c.front_length * yaw_rate) / forward) - steer * (vx / forward)
    return rear, front


def forces(
    vx: Scalar, vy: Scalar, yaw_rate: Scalar, inputs: DriveTrain, normal_z: Scalar, c: Constants, f: Elementary
) -> Force:
    """Return the force vector F (eq. 1).

    Args:
        vx, vy: body velocity [m/s].
        yaw_rate: [rad/s].
        normal_z: vertical component eta_z of the mean surface normal.
    """
    throttle, brake, steer, engine, gear = inputs
    rear_slip, front_slip = slip_angles(vx, vy, yaw_rate, steer, c, f)
    # Clamped at zero: throttle must not brake at high engine speed, and negative pressure must not accelerate.
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
    """Return the time derivatives of the state, h(F, x) of eq. 4.

    Args:
        normal_x, normal_y: components eta_x, eta_y of the mean surface normal in the planar body frame. The normal
            tilts back when the nose goes up, so gravity has a positive sign.
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
    """Open interval of a learned constant and its initial value."""

    low: float
    high: float
    initial: float


RANGES: Final[Mapping[str, Range]] = {
    # Accelerations [m/s^2]; forces act at both axles, hence the halves.
    "drive_1": Range(0, 10, 1.5),
    "drive_bend": Range(0, 10, 0.75),
    "engine_1": Range(-1, 1, 0),
    "engine_2": Range(-0.5, 0.5, 0),
    "brake_1": Range(0, 4, 0.5),
    "brake_2": Range(0, 4, 0.5),
    "resistance": Range(0, 2.5, 0.3),
    "resistance_slope": Range(0, 1 / STANDSTILL, 1),
    # An axle carries less than the total weight, and its friction coefficient is below 1. A sliding tyre retains at
    # least sin(C) = 0.7 of its peak force.
    "rear_peak": Range(0, GRAVITY, 4),
    "rear_shape": Range(0, 2.35, 1.3),
    "rear_stiffness": Range(0, 20, 3),
    "front_peak": Range(0, GRAVITY, 4),
    "front_shape": Range(0, 2.35, 1.3),
    "front_stiffness": Range(0, 20, 3),
    # In wheelbases; the pose point lies between the axles.
    "rear_length": Range(0, 1, 0.5),
    "front_length": Range(0, 1, 0.5),
    # Relative to the stability bound of forward Euler.
    "min_slip_speed": Range(1, 4, 2),
    # Yaw gain relative to its steady-state value vx delta / wheelbase (above 1 if the rig's largest steering angle is
    # too small); damping [1/s].
    "yaw_understeer": Range(0, 1.5, 0.9),
    "yaw_damping": Range(0.2, 40, 5),
    # Aerodynamic drag alone, 1.2 c_d A / (2 m), is about 0.003 /m.
    "drag_x": Range(0, 0.05, 0.005),
    "drag_y": Range(0, 0.05, 0.005),
    # Up to 10 % above g, for slopes that the map or the path smooths; noise of the slopes lowers the estimate.
    "gravity_x": Range(0, 1.1 * GRAVITY, GRAVITY),
    "gravity_y": Range(0, 1.1 * GRAVITY, GRAVITY),
}


def constrained(u: Mapping[str, Scalar], mass: float, wheelbase: float, f: Elementary) -> Constants:
    """Return the constants of values inside `RANGES`.

    Signs: tyre peaks and stiffnesses are positive and shapes below 3 pi / 4, so tyre forces oppose slip at every angle.
    Brake force, rolling resistance, drag and gravity are positive; drive force is positive and increases with throttle.
    Energy: the yaw rate follows the steering, not the tyres' moments, so a front axle that turns faster than its wheels
    point would accelerate the vehicle for ever. Both axle distances are therefore shortened together until
    understeer (L_R + L_F) is at most the wheelbase, the geometry of rolling without slip.
    Stability: C_max is at least dt (D_F C_F B_F + D_R C_R B_R) / m, half of the stability bound of forward Euler.

    Args:
        u: values by name.
        mass: [kg].
        wheelbase: [m].
    """
    slope = (
        u["rear_peak"] * u["rear_shape"] * u["rear_stiffness"]
        + u["front_peak"] * u["front_shape"] * u["front_stiffness"]
    )
    turned = u["yaw_understeer"] * (u["rear_length"] + u["front_length"])
    reach = wheelbase / f.maximum(turned, 0 * turned + 1)
    force_scaled = ("drive_1", "brake_1", "brake_2", "resistance", "rear_peak", "front_peak")
    unscaled = (
        "engine_1", "engine_2", "resistance_slope", "rear_shape", "rear_stiffness", "front_shape", "front_stiffness",
        "yaw_damping", "drag_x", "drag_y", "gravity_x", "gravity_y",
    )  # fmt: skip
    return Constants(
        **{name: mass * u[name] for name in force_scaled},
        **{name: u[name] for name in unscaled},
        drive_2=mass * (u["drive_bend"] - u["drive_1"] / 2),
        rear_length=reach * u["rear_length"],
        front_length=reach * u["front_length"],
        min_slip_speed=u["min_slip_speed"] * DT * slope,
        yaw_gain=u["yaw_understeer"] * u["yaw_damping"] / wheelbase,
        mass=mass,
    )
