"""Forces on the vehicle's bodies, and one small step of its internal states (compiled).

MuJoCo integrates the rigid bodies under the forces computed here: tyres, suspension, air, plants, and chassis contact
with ground and trees. A wheel's spin follows J dw/dt = drive - brake - F r. The body receives the ground force at the
contact, less J dw/dt about the axle and the gyroscopic torque; drive and brake torques are internal to the vehicle.
Chassis contact is a soft penalty that keeps the vehicle above ground; it does not model crashes.
"""

import numpy as np

from offpiste.core.conventions import GRAVITY
from offpiste.native.compilation import PHYSICS, call_address
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
from offpiste.simulation.world.grids import height, properties_at

RATIO, PRESSURE, STEER, STEER_RATE = range(4)
"""Columns of the actuator states."""
MIN_SLIP_SPEED = 0.5
"""Smallest ground speed in slip ratios and angles [m/s]; among the forces, only sinkage drag depends on it."""
TOUCH_STIFFNESS, TOUCH_DAMPING, TOUCH_FRICTION = 80e3, 4e3, 0.5
"""Contact of a chassis point with the ground [N/m, N s/m, 1]."""
TREE_STIFFNESS, TREE_DAMPING = 300e3, 30e3
"""Contact of a trunk with the body [N/m, N s/m]."""
PUSH_SPEED = 0.3
"""Speed below which the drag of plants and the friction of the body fade out [m/s]."""


@PHYSICS.entry
def substep(  # type: ignore[no-untyped-def]
    q, dt, command, around, elevation, properties, x0, y0, resolution,
    qpos, qvel, actuators, speeds, deflection, truth, touched, body_forces, joint_forces, buffers,
):  # fmt: skip
    """Advance actuators, engine, wheel spins and tyres by dt, and write the forces on the bodies.

    All arrays from `actuators` on are updated in place.

    Args:
        q: `VehicleParameters.as_record()`.
        command: throttle, (delayed) brake, steer, engaged gear [4].
        around: result of `look_around`.
        elevation, properties, x0, y0, resolution: grids of the world.
        qpos, qvel: MuJoCo's state [11], [10].
        actuators: belt ratio, brake pressure, steering angle and rate [4].
        speeds: engine, wheels [5] [rad/s].
        deflection: tyres [4, 2] [m].
        truth: contact (3), properties (4), load, slip ratio, slip angle of each wheel [4, 10].
        touched: roof, tree [2]; set to 1 if the chassis touched.
        body_forces: force and torque on each body in the world frame [6, 6].
        joint_forces: [10].
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
    """Run `substep` and MuJoCo's step `count` times; twice as fast as calling both from Python.

    Args:
        mj_step: address of MuJoCo's function.
        bodies: addresses of its model and data.
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
    # Add the ground force on wheel i and its moment about the wheel's centre; return the torque on the wheel's spin.
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
    lean = dot(turned(rates, forward, left, up), ahead)  # rotation of the wheel plane moves the contact sideways
    along, across = dot(velocity, ahead), dot(velocity, side) + lean * max(q.wheel_radius - compression, 0.0)
    x, y, rolling_x, rolling_y = _tyre(q, dt, i, along, across, speed, load, deflection, row)
    # Friction limits the whole horizontal force, including that of a locked wheel that plows.
    total_x, total_y = limit_force(x + rolling_x, y + rolling_y, row[3] * load)
    force = add(add(add((0.0, 0.0, 0.0), ahead, total_x), side, total_y), normal, load)
    torque = cross(add(contact, centre, -1.0), force)
    for k in range(3):
        body_forces[2 + i, k] = force[k]
        body_forces[2 + i, 3 + k] = torque[k]
    return -x * q.rolling_radius


@PHYSICS.entry
def _tyre(q, dt, i, along, across, speed, load, deflection, row):  # type: ignore[no-untyped-def]
    # Force of the bristles and resistance of the ground, each (forward, left) in the contact plane.
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
    # MuJoCo has no wheel spin: apply the change and the precession of its angular momentum to the body.
    axle = _axle(body, angle)
    rates = turned((qvel[3], qvel[4], qvel[5]), body[0], body[1], body[2])
    gyroscopic = cross(rates, axle)
    for k in range(3):
        body_forces[2 + i, 3 + k] -= q.wheel_inertia * (acceleration * axle[k] + speed * gyroscopic[k])


@PHYSICS.entry
def suspension_force(travel, rate, other, spring, damper, anti_roll, load, p):  # type: ignore[no-untyped-def]
    """Return the force of spring, damper, anti-roll bar and stops, pushing the wheel down and the chassis up [N].

    Args:
        travel, rate: travel of the wheel from rest, positive up [m], and its rate [m/s].
        other: travel of the opposite wheel [m].
        load: load of the spring at rest [N].
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


@PHYSICS.entry
def look_around(  # type: ignore[no-untyped-def]
    trees, trunk_radius, bushes, bush_radius, drag, x, y, cos_yaw, sin_yaw, length, width, around
):  # fmt: skip
    """Find obstacles near the body, given its centre, heading and size [m].

    Args:
        around: result [4], zero before: x, y, radius of the nearest trunk [m]; drag of the bushes under the body [N].
    """
    nearest = length
    for n in range(len(trees)):
        dx, dy = trees[n, 0] - x, trees[n, 1] - y
        gap = np.sqrt(dx * dx + dy * dy) - trunk_radius[n]
        if gap < nearest:
            nearest = gap
            around[0], around[1], around[2] = trees[n, 0], trees[n, 1], trunk_radius[n]
    for n in range(len(bushes)):
        dx, dy = bushes[n, 0] - x, bushes[n, 1] - y
        ahead = max(abs(cos_yaw * dx + sin_yaw * dy) - 0.5 * length, 0.0)
        aside = max(abs(cos_yaw * dy - sin_yaw * dx) - 0.5 * width, 0.0)
        if np.sqrt(ahead * ahead + aside * aside) < bush_radius[n]:
            around[3] += drag[n]


@PHYSICS.entry
def chassis_forces(q, around, body, qpos, qvel, elevation, x0, y0, resolution, touched, body_forces):  # type: ignore[no-untyped-def]
    """Add the forces on the chassis to row 1 of `body_forces`; arguments as in `substep`."""
    velocity = (qvel[0], qvel[1], qvel[2])
    com = (q.sprung_com_x, q.sprung_com_y, q.sprung_com_z)
    speed = np.sqrt(dot(velocity, velocity))
    planar = np.sqrt(qvel[0] * qvel[0] + qvel[1] * qvel[1])
    air = 0.5 * q.air_density * q.drag_area * speed
    bush = around[3] * np.tanh(planar / PUSH_SPEED) / (planar + 1e-9)
    pull = (-(air + bush) * qvel[0], -(air + bush) * qvel[1], -air * qvel[2])
    _push(pull, com, com, body, body_forces)

    half, side = 0.5 * q.length, 0.5 * q.width
    for number in range(12):
        sx, sy = 1.0 if number % 2 == 0 else -1.0, 1.0 if number % 4 < 2 else -1.0
        if number < 4:
            point = (sx * half, sy * side, q.bumper_height)
        elif number < 8:
            point = (sx * 0.25 * q.wheelbase, sy * 0.5 * side, q.belly_height)
        else:
            point = (sx * 0.2 * q.length - 0.1 * q.length, sy * 0.85 * side, q.roof_height)
        if _touch_ground(point, com, body, qpos, qvel, elevation, x0, y0, resolution, body_forces) and number >= 8:
            touched[0] = 1.0
    if around[2] > 0.0:
        _touch_tree(q, around, com, body, qpos, qvel, touched, body_forces)


@PHYSICS.entry
def _push(force, point, com, body, body_forces):  # type: ignore[no-untyped-def]
    # Apply a world-frame force at a body-frame point; MuJoCo expects the torque about the centre of mass.
    torque = cross(turned(add(point, com, -1.0), body[0], body[1], body[2]), force)
    for k in range(3):
        body_forces[1, k] += force[k]
        body_forces[1, 3 + k] += torque[k]


@PHYSICS.entry
def _moving(point, body, qvel):  # type: ignore[no-untyped-def]
    turn = turned(cross((qvel[3], qvel[4], qvel[5]), point), body[0], body[1], body[2])
    return add((qvel[0], qvel[1], qvel[2]), turn, 1.0)


@PHYSICS.entry
def _touch_ground(point, com, body, qpos, qvel, elevation, x0, y0, resolution, body_forces):  # type: ignore[no-untyped-def]
    place = add((qpos[0], qpos[1], qpos[2]), turned(point, body[0], body[1], body[2]), 1.0)
    depth = height(elevation, x0, y0, resolution, place[0], place[1]) - place[2]
    if depth <= 0.0:
        return False
    velocity = _moving(point, body, qvel)
    load = max(TOUCH_STIFFNESS * depth - TOUCH_DAMPING * velocity[2], 0.0)
    planar = np.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
    drag = TOUCH_FRICTION * load * np.tanh(planar / PUSH_SPEED) / (planar + 1e-9)
    _push((-drag * velocity[0], -drag * velocity[1], load), point, com, body, body_forces)
    return True


@PHYSICS.entry
def _touch_tree(q, around, com, body, qpos, qvel, touched, body_forces):  # type: ignore[no-untyped-def]
    # Contact of a circle with the body's footprint in the plane, at bumper height.
    forward = body[0]
    size = np.sqrt(forward[0] * forward[0] + forward[1] * forward[1]) + 1e-9
    c, s = forward[0] / size, forward[1] / size
    dx, dy = around[0] - qpos[0], around[1] - qpos[1]
    x, y = c * dx + s * dy, c * dy - s * dx
    half, side = 0.5 * q.length, 0.5 * q.width
    near_x, near_y = min(max(x, -half), half), min(max(y, -side), side)
    gap_x, gap_y = x - near_x, y - near_y
    gap = np.sqrt(gap_x * gap_x + gap_y * gap_y)
    depth = around[2] - gap
    if depth <= 0.0:
        return
    touched[1] = 1.0
    if gap > 1e-6:
        nx, ny = gap_x / gap, gap_y / gap
    else:  # the trunk's centre is inside: push out through the nearer end
        nx, ny = (1.0 if x > 0.0 else -1.0), 0.0
        depth += half - abs(x)
    normal = (c * nx - s * ny, s * nx + c * ny, 0.0)
    point = (near_x, near_y, q.bumper_height)
    closing = dot(_moving(point, body, qvel), normal)
    load = max(TREE_STIFFNESS * depth + TREE_DAMPING * closing, 0.0)
    _push((-load * normal[0], -load * normal[1], 0.0), point, com, body, body_forces)
