"""Drive train: engine, CVT, gear box, four-wheel drive, brakes and steering; compiled scalars but for the gear box.

Engine and wheels are five inertias (engine, then wheels in the order of `WHEELS`). Couplings convert slip into torque:
a centrifugal clutch with the belt's ratio behind it, a rigid centre coupling, an open front and a viscous rear
differential. One implicit step solves all of them; couplings and brakes are passive, so stiff ones do not oscillate.
"""

import numpy as np

from offpiste.native.compilation import PHYSICS

COULOMB_SPEED = 1e-4
"""Wheel speed below which a brake acts like stiff viscous friction instead of dry friction [rad/s]."""


@PHYSICS.entry
def engine_torque(speed, throttle, p):  # type: ignore[no-untyped-def]
    """Return the torque of the engine with limiter and idle governor at a speed [rad/s] and throttle 0..1 [N m]."""
    bend = (speed - p.engine_torque_speed) / p.engine_torque_speed
    full = p.engine_torque * max(1.0 - p.engine_torque_bend * bend * bend, 0.0)
    open_share = throttle * min(max((p.limiter_speed - speed) / p.limiter_band, 0.0), 1.0)
    drag = (p.engine_drag + p.engine_drag_slope * speed) * min(speed / 10.0, 1.0)
    idle = p.idle_gain * max(p.idle_speed - speed, 0.0) * (1.0 - throttle)
    return open_share * full - (1.0 - open_share) * drag + idle


@PHYSICS.entry
def shifted_ratio(ratio, shaft_speed, throttle, dt, p):  # type: ignore[no-untyped-def]
    """Return the belt ratio (engine over secondary shaft) one step later; it lags behind the wanted engine speed.

    Args:
        shaft_speed: speed of the secondary shaft [rad/s].
    """
    wanted_speed = p.cruise_speed + (p.power_speed - p.cruise_speed) * throttle
    wanted = min(max(wanted_speed / max(shaft_speed, 1.0), p.ratio_high), p.ratio_low)
    return ratio + (wanted - ratio) * dt / (p.shift_time + dt)


@PHYSICS.entry
def clutch_rate(engine_speed, slip, p):  # type: ignore[no-untyped-def]
    """Return the torque over slip of the centrifugal clutch, limited by its capacity [N m s/rad].

    Args:
        engine_speed: [rad/s].
        slip: engine speed minus the speed behind the clutch; the faster side engages it, as a sprag clutch does.
    """
    speed = max(engine_speed, engine_speed - slip)
    capacity = p.clutch_gain * max(speed * speed - p.clutch_speed * p.clutch_speed, 0.0)
    return min(p.clutch_rate, capacity / max(abs(slip), 1e-6))


@PHYSICS.entry
def spin(speeds, ratio, throttle, brake, tyre_torque, dt, p, matrix):  # type: ignore[no-untyped-def]
    """Advance engine and wheels by one step.

    Args:
        speeds: [5], updated in place [rad/s].
        ratio: belt ratio, negative in reverse, 0 in neutral.
        throttle, brake: throttle and brake pressure, 0..1.
        tyre_torque: torque of the ground on the wheels [4] [N m].
        matrix: buffer [5, 6].
    """
    total = ratio * p.final_ratio
    matrix[:] = 0.0
    matrix[0, 0] = p.engine_inertia / dt
    matrix[0, 5] = p.engine_inertia / dt * speeds[0] + engine_torque(speeds[0], throttle, p)
    for i in range(4):
        share = p.brake_front_share if i < 2 else 1.0 - p.brake_front_share
        dry = 0.5 * share * brake * p.brake_torque + p.shaft_drag
        hold = dry / max(abs(speeds[i + 1]), COULOMB_SPEED) + p.shaft_drag_slope
        matrix[i + 1, i + 1] = p.wheel_inertia / dt + hold
        matrix[i + 1, 5] = p.wheel_inertia / dt * speeds[i + 1] + tyre_torque[i]
    slip = speeds[0] - total * 0.25 * (speeds[1] + speeds[2] + speeds[3] + speeds[4])
    side = -0.25 * total
    engaged = clutch_rate(speeds[0], slip, p) if ratio != 0.0 else 0.0
    _couple(matrix, engaged, 1.0, side, side, side, side)
    _couple(matrix, p.centre_rate, 0.0, 0.5, 0.5, -0.5, -0.5)
    _couple(matrix, p.front_rate, 0.0, 1.0, -1.0, 0.0, 0.0)
    _couple(matrix, p.rear_rate, 0.0, 0.0, 0.0, 1.0, -1.0)
    _solve(matrix, speeds)
    speeds[0] = max(speeds[0], 0.0)


@PHYSICS.entry
def _couple(matrix, rate, engine, front_left, front_right, rear_left, rear_right):  # type: ignore[no-untyped-def]
    # A coupling whose slip is u . speeds and whose torques are -rate (u . speeds) u adds rate u u^T.
    u = (engine, front_left, front_right, rear_left, rear_right)
    for i in range(5):
        for j in range(5):
            matrix[i, j] += rate * u[i] * u[j]


@PHYSICS.entry
def _solve(matrix, solution):  # type: ignore[no-untyped-def]
    # Gaussian elimination without pivoting: the matrix is symmetric and positive definite.
    for k in range(5):
        for i in range(k + 1, 5):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k, 6):
                matrix[i, j] -= factor * matrix[k, j]
    for k in range(4, -1, -1):
        value = matrix[k, 5]
        for j in range(k + 1, 5):
            value -= matrix[k, j] * solution[j]
        solution[k] = value / matrix[k, k]


@PHYSICS.entry
def braked_pressure(pressure, command, dt, p):  # type: ignore[no-untyped-def]
    """Brake pressure one step later: a first-order lag behind the (delayed) command [0..1]."""
    return pressure + (command - pressure) * dt / (p.brake_time + dt)


@PHYSICS.entry
def steered(angle, rate, command, dt, p):  # type: ignore[no-untyped-def]
    """Return the steering angle [rad] and rate [rad/s] one step later, both limited; command -1..1, positive left."""
    frequency = p.steer_frequency
    pull = frequency * frequency * (command * p.max_steer - angle) - 2.0 * p.steer_damping * frequency * rate
    rate = min(max(rate + pull * dt, -p.max_steer_rate), p.max_steer_rate)
    moved = angle + rate * dt
    if abs(moved) > p.max_steer:
        return min(max(moved, -p.max_steer), p.max_steer), 0.0
    return moved, rate


@PHYSICS.entry
def wheel_angles(angle, p):  # type: ignore[no-untyped-def]
    """Return the Ackermann angles of both front wheels for the angle of a wheel midway between them [rad]."""
    curvature = np.tan(angle) / p.wheelbase
    side = 0.5 * p.track * curvature
    return np.arctan(p.wheelbase * curvature / (1.0 - side)), np.arctan(p.wheelbase * curvature / (1.0 + side))


class GearBox:
    """Forward, neutral and reverse gear; a shift needs a standstill and takes `steps` of `DT` in neutral."""

    def __init__(self, steps: int) -> None:
        self._steps, self._lever, self._left = steps, 1.0, 0

    @property
    def engaged(self) -> float:
        """1 forward, -1 reverse, 0 neutral."""
        return 0.0 if self._left else self._lever

    def shift(self, wanted: float | None, *, moving: bool) -> None:
        """Advance by one step and shift to a gear (1, 0 or -1; None keeps it) unless the vehicle moves."""
        self._left = max(self._left - 1, 0)
        if wanted is not None and wanted != self._lever and not moving:
            self._lever, self._left = float(wanted), self._steps
