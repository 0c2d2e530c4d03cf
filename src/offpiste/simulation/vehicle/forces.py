"""All forces on the vehicle, and one small step of its internal states (compiled).

MuJoCo holds the rigid bodies; this writes the forces on them: tyres, suspension, air, plants, and the chassis where
it touches ground or a tree. Newton's law for a wheel and its spin: the spin turns with J dw/dt = drive - brake - F r,
and the body feels the whole ground force at the contact less J dw/dt about the axle and the gyroscopic torque. Drive
and brake torque react inside the vehicle, wherever their housings hang.
"""

import numpy as np

from offpiste.compilation import PHYSICS, call_address
from offpiste.core.conventions import GRAVITY
from offpiste.simulation.vehicle.chassis import chassis_forces
from offpiste.simulation.vehicle.drivetrain import braked_pressure, shifted_ratio, spin, steered, wheel_angles
from offpiste.simulation.vehicle.tyre import (
    add,
    axes,
    brush_force,
    contact_axes,
    cross,
    dot,
    ground_under,
    limit_deflection,
    limit_force,
    normal_load,
    relax,
    standstill_fade,
    touch,
    turned,
)
from offpiste.simulation.world.surface import properties_at

RATIO, PRESSURE, STEER, STEER_RATE = range(4)
"""Columns of the actuator states."""

CONTACT, PROPERTIES, LOAD, SLIP_RATIO, SLIP_ANGLE = 0, 3, 7, 8, 9
"""First columns of each quantity in a wheel's truth."""

MIN_SLIP_SPEED = 0.5
"""Least ground speed in slip ratios and angles [m/s]; of all forces only sinkage drag depends on it."""


@PHYSICS.entry
def substep(  # type: ignore[no-untyped-def]
    q, dt, command, around, elevation, properties, x0, y0, resolution,
    qpos, qvel, actuators, speeds, deflection, truth, touched, body_forces, joint_forces, buffers,
):  # fmt: skip
    """Advance actuators, engine, wheel spins and tyres by dt, and write the forces on the bodies.

    Args:
        q: `VehicleParameters.as_record()`.
        command: [4] throttle, (delayed) brake, steer, engaged gear.
        around: `chassis.nearby_obstacles`.
        elevation, properties, x0, y0, resolution: of the world.
        qpos, qvel: [11], [10] of MuJoCo.
        actuators: [4], overwritten.
        speeds: [5] engine, wheels [rad/s], overwritten.
        deflection: [4, 2] of the tyres [m], overwritten.
        truth: [4, 10], overwritten.
        touched: [2] roof, tree: set to 1 where the chassis touched.
        body_forces: [6, 6] force and torque on each body, world frame, overwritten.
        joint_forces: [10], overwritten.
        buffers: [6, 6].
    """
    body = axes(qpos[3], qpos[4], qpos[5], qpos[6])
    actuators[PRESSURE] = braked_pressure(actuators[PRESSURE], command[1], dt, q)
    actuators[STEER], actuators[STEER_RATE] = steered(actuators[STEER], actuators[STEER_RATE], command[2], dt, q)
    shaft = command[3] * q.final_ratio * 0.25 * (speeds[1] + speeds[2] + speeds[3] + speeds[4])
    actuators[RATIO] = shifted_ratio(actuators[RATIO], shaft, command[0], dt, q)

    before = (speeds[1], speeds[2], speeds[3], speeds[4])
    tyre_torque = buffers[5, :4]
    left_angle, right_angle = wheel_angles(actuators[STEER], q)
    body_forces[:] = 0.0
    for i in range(4):
        angle = left_angle if i == 0 else right_angle if i == 1 else 0.0
        tyre_torque[i] = _wheel_forces(
            q, dt, i, angle, body, qpos, qvel, elevation, properties, x0, y0, resolution,
            speeds[i + 1], deflection, truth, body_forces,
        )  # fmt: skip
    spin(speeds, command[3] * actuators[RATIO], command[0], actuators[PRESSURE], tyre_torque, dt, q, buffers[:5])
    for i in range(4):
        angle = left_angle if i == 0 else right_angle if i == 1 else 0.0
        _react(q, i, angle, body, qvel, (speeds[i + 1] - before[i]) / dt, speeds[i + 1], body_forces)
    _suspend(q, qpos, qvel, joint_forces)
    chassis_forces(q, around, body, qpos, qvel, elevation, x0, y0, resolution, touched, body_forces)


@PHYSICS.entry
def substeps(  # type: ignore[no-untyped-def]
    count, mj_step, bodies,
    q, dt, command, around, elevation, properties, x0, y0, resolution,
    qpos, qvel, actuators, speeds, deflection, truth, touched, body_forces, joint_forces, buffers,
):  # fmt: skip
    """Small steps, each of which MuJoCo ends: less than half the time of calling both from Python.

    Args:
        count: number of steps.
        mj_step: address of MuJoCo's function.
        bodies: addresses of its model and data.
        q: this and what follows as in `substep`.
    """
    for _ in range(count):
        substep(
            q, dt, command, around, elevation, properties, x0, y0, resolution,
            qpos, qvel, actuators, speeds, deflection, truth, touched, body_forces, joint_forces, buffers,
        )  # fmt: skip
        call_address(mj_step, bodies)  # type: ignore[call-arg]


@PHYSICS.entry
def _axle(body, angle):  # type: ignore[no-untyped-def]
    forward, left, _ = body
    c, s = np.cos(angle), np.sin(angle)
    return (c * left[0] - s * forward[0], c * left[1] - s * forward[1], c * left[2] - s * forward[2])


@PHYSICS.entry
def _wheel_forces(  # type: ignore[no-untyped-def]
    q, dt, i, angle, body, qpos, qvel, elevation, properties, x0, y0, resolution,
    speed, deflection, truth, body_forces,
):  # fmt: skip
    # Ground force on wheel i, its moment about the wheel's centre, and the torque that it turns the wheel with.
    forward, left, up = body
    arm = (0.5 * q.wheelbase * (1.0 if i < 2 else -1.0), 0.5 * q.track * (1.0 if i % 2 == 0 else -1.0), qpos[7 + i])
    rates = (qvel[3], qvel[4], qvel[5])
    turn = cross(rates, arm)
    centre = add((qpos[0], qpos[1], qpos[2]), turned(arm, forward, left, up), 1.0)
    moved = turned((turn[0], turn[1], turn[2] + qvel[6 + i]), forward, left, up)
    velocity = add((qvel[0], qvel[1], qvel[2]), moved, 1.0)
    axle = _axle(body, angle)

    heading = cross(axle, up)
    ground, normal = ground_under(elevation, x0, y0, resolution, centre, heading, q)
    compression, contact = touch(centre, ground, normal, axle, q.wheel_radius)
    load = normal_load(compression, -dot(velocity, normal), q)
    row = truth[i]
    row[0], row[1], row[2] = contact
    properties_at(properties, x0, y0, resolution, contact[0], contact[1], row[3:7])
    row[7], row[8], row[9] = load, 0.0, 0.0
    if load <= 0.0:
        deflection[i, 0] = deflection[i, 1] = 0.0
        return 0.0

    ahead, side = contact_axes(normal, axle)
    lean = dot(turned(rates, forward, left, up), ahead)  # of the wheel plane: moves the patch sideways
    along, across = dot(velocity, ahead), dot(velocity, side) + lean * max(q.wheel_radius - compression, 0.0)
    x, y, rolling_x, rolling_y = _tyre(q, dt, i, along, across, speed, load, deflection, row)
    # Friction bounds the whole horizontal force: a locked wheel that plows does not brake better than its ground holds.
    total_x, total_y = limit_force(x + rolling_x, y + rolling_y, row[3] * load)
    force = add(add(add((0.0, 0.0, 0.0), ahead, total_x), side, total_y), normal, load)
    torque = cross(add(contact, centre, -1.0), force)
    for k in range(3):
        body_forces[2 + i, k] = force[k]
        body_forces[2 + i, 3 + k] = torque[k]
    return -x * q.rolling_radius


@PHYSICS.entry
def _tyre(q, dt, i, along, across, speed, load, deflection, row):  # type: ignore[no-untyped-def]
    # Force of the bristles and resistance of the ground, both (forward, left) in the contact plane.
    friction, stiffness = row[3], row[4]
    rolling = speed * q.rolling_radius
    sliding = along - rolling
    stiff_x = q.slip_stiffness_ratio * stiffness
    length = q.relaxation_length
    slip_x = relax(deflection[i, 0], sliding, rolling, length, dt) / length
    slip_y = relax(deflection[i, 1], across, rolling, length, dt) / length
    slip_x, slip_y = limit_deflection(slip_x, slip_y, stiff_x, stiffness, friction)
    deflection[i, 0], deflection[i, 1] = slip_x * length, slip_y * length
    damping = q.standstill_damping / length * standstill_fade(rolling, q.standstill_speed)
    x, y = brush_force(slip_x + damping * sliding, slip_y + damping * across, stiff_x, stiffness, friction, load)

    row[8] = min(max(-sliding / max(abs(along), MIN_SLIP_SPEED), -1.0), 1.0)
    row[9] = np.arctan(across / max(abs(along), MIN_SLIP_SPEED))
    travel = np.sqrt(along * along + across * across) + 1e-12
    resistance = load * (row[5] + row[6] * abs(row[8])) * np.tanh(travel / q.resistance_speed) / travel
    return x, y, -resistance * along, -resistance * across


@PHYSICS.entry
def _react(q, i, angle, body, qvel, acceleration, speed, body_forces):  # type: ignore[no-untyped-def]
    # The spin's angular momentum is not MuJoCo's: its change and its turning act back on the body.
    axle = _axle(body, angle)
    rates = turned((qvel[3], qvel[4], qvel[5]), body[0], body[1], body[2])
    gyroscopic = cross(rates, axle)
    for k in range(3):
        body_forces[2 + i, 3 + k] -= q.wheel_inertia * (acceleration * axle[k] + speed * gyroscopic[k])


@PHYSICS.entry
def suspension_force(travel, rate, other, spring, damper, anti_roll, load, p):  # type: ignore[no-untyped-def]
    """Force of spring, damper, anti-roll bar and stops that pushes a wheel down and the chassis up [N].

    Args:
        travel: of the wheel from rest, + up [m]; rate: [m/s].
        other: travel of the wheel across the axle [m].
        load: of the spring at rest [N].
    """
    damping = damper * (1.0 - p.damper_asymmetry if rate > 0.0 else 1.0 + p.damper_asymmetry)
    force = max(load + spring * travel, 0.0) + damping * rate + anti_roll * (travel - other)
    over, under = travel - p.bump_travel, -p.droop_travel - travel
    if over > 0.0:
        force += max(p.stop_stiffness * over + p.stop_damping * rate, 0.0)
    if under > 0.0:
        force -= max(p.stop_stiffness * under - p.stop_damping * rate, 0.0)
    return force


@PHYSICS.entry
def _suspend(q, qpos, qvel, joint_forces):  # type: ignore[no-untyped-def]
    for i in range(4):
        front = i < 2
        load = (q.static_load_front if front else q.static_load_rear) - q.unsprung_mass * GRAVITY
        joint_forces[6 + i] = -suspension_force(
            qpos[7 + i], qvel[6 + i], qpos[7 + (i ^ 1)],
            q.spring_front if front else q.spring_rear,
            q.damper_front if front else q.damper_rear,
            q.anti_roll_front if front else q.anti_roll_rear,
            load, q,
        )  # fmt: skip
