"""Forces on the chassis itself: air, plants, contact with the ground, and trees (compiled scalars).

Contact is a soft penalty: it only keeps the vehicle above ground and is no crash test.
"""

import numpy as np
from jaxtyping import Float

from offpiste.compilation import PHYSICS
from offpiste.simulation.vehicle.tyre import add, cross, dot, turned
from offpiste.simulation.world.surface import height
from offpiste.simulation.world.world import World

TOUCH_STIFFNESS, TOUCH_DAMPING, TOUCH_FRICTION = 80e3, 4e3, 0.5
"""Contact of one chassis point with the ground [N/m, N s/m, 1]."""

TREE_STIFFNESS, TREE_DAMPING = 300e3, 30e3
"""Contact of a trunk with the body [N/m, N s/m]."""

PUSH_SPEED = 0.3
"""Speed below which drag of plants and friction of the body fade out [m/s]."""


def nearby_obstacles(
    world: World, x: float, y: float, cos_yaw: float, sin_yaw: float, length: float, width: float
) -> Float[np.ndarray, " 4"]:
    """Obstacles around the body: x, y, radius of the nearest trunk [m] (radius 0: none), drag of bushes under it [N].

    Args:
        x, y: centre of the body [m].
        cos_yaw, sin_yaw: its heading.
        length, width: its size [m].
    """
    trees, bushes, around = world.trees, world.bushes, np.zeros(4)
    _look_around(
        trees.foot, trees.trunk_radius, bushes.foot, bushes.radius, bushes.drag, x, y, cos_yaw, sin_yaw, length, width,
        around,
    )  # fmt: skip
    return around


@PHYSICS.entry
def _look_around(  # type: ignore[no-untyped-def]
    trees, trunk_radius, bushes, bush_radius, drag, x, y, cos_yaw, sin_yaw, length, width, around
):  # fmt: skip
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
    """Add the forces on the chassis to row 1 of `body_forces`; arguments as in `forces.substep`."""
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
    # A world-frame force at a body-frame point; MuJoCo wants its torque about the centre of mass.
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
    # Circle against the body's footprint in the plane, pushed at bumper height.
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
    else:  # the trunk's centre is inside: out through the nearer end
        nx, ny = (1.0 if x > 0.0 else -1.0), 0.0
        depth += half - abs(x)
    normal = (c * nx - s * ny, s * nx + c * ny, 0.0)
    point = (near_x, near_y, q.bumper_height)
    closing = dot(_moving(point, body, qvel), normal)
    load = max(TREE_STIFFNESS * depth + TREE_DAMPING * closing, 0.0)
    _push((-load * normal[0], -load * normal[1], 0.0), point, com, body, body_forces)
