"""Terms of the cost of driving, each a function of plain scalars: cost per second at one moment.

Like the physics (`dynamics.bicycle`) they are written once. With torch's `maximum` and tensors they are the reference;
Numba compiles the same functions into the fused kernel with its own. Hence arithmetic only, and no numbers: a literal
would make float32 lanes float64; x - x is 0, or NaN. What is not finite makes the cost not finite, and the trajectory
infinitely dear.
"""

from collections.abc import Callable
from typing import Any

Scalar = Any
"""A number or a tensor of any shape."""

Maximum = Callable[[Scalar, Scalar], Scalar]


def path_term(distance: Scalar, weight: Scalar) -> Scalar:
    """Being off the path: weight distance^2.

    Args:
        distance: to the path [m].
        weight: [1/s per m^2].
    """
    return weight * distance * distance


def speed_term(
    yaw: tuple[Scalar, Scalar],
    vx: Scalar,
    vy: Scalar,
    direction: tuple[Scalar, Scalar],
    target: Scalar,
    weight: Scalar,
) -> Scalar:
    """Going along the course slower or faster than wanted: weight (v_along - target)^2.

    Args:
        yaw: its cosine and sine.
        vx, vy: of the body [m/s].
        direction: of the course, a unit vector in the world.
        target: speed along the course [m/s].
        weight: [1/s per (m/s)^2].
    """
    cos, sin = yaw
    x, y = direction
    along = (cos * vx - sin * vy) * x + (sin * vx + cos * vy) * y
    return weight * (along - target) * (along - target)


def overspeed_term(vx: Scalar, limit: Scalar, weight: Scalar, maximum: Maximum) -> Scalar:
    """Going faster than rough ground allows: weight (|vx| - limit)^2 above the limit.

    Args:
        vx, limit: [m/s]; the limit may be infinite.
        weight: [1/s per (m/s)^2].
    """
    above = maximum(maximum(vx, -vx) - limit, vx - vx)
    return weight * above * above


def lateral_ratio(
    acceleration: Scalar, normal_y: Scalar, normal_z: Scalar, gravity: Scalar, least: Scalar, maximum: Maximum
) -> Scalar:
    """Lateral over vertical acceleration as the vehicle feels them on its ground.

    A vehicle rolls over where this passes track width / (2 height of the centre of mass), its static stability factor
    (NHTSA, 2000). The specific force in the body's lateral plane is (a_y, g); along the ground's lateral tangent and
    its normal it has the parts a_y n_z - g n_y and a_y n_y + g n_z. On level ground the ratio is |a_y| / g, at rest on
    a side slope its rise over run. The ground's curvature along the path is left out.

    Args:
        acceleration: a_y, of the pose point in the horizontal plane, + left [m/s^2].
        normal_y, normal_z: of the ground, turned by minus yaw; normal_y > 0 where the ground falls to the left.
        gravity: [m/s^2].
        least: vertical acceleration that less is counted as, so that lifting off is dear and not negative [m/s^2].
    """
    lateral = acceleration * normal_z - gravity * normal_y
    vertical = acceleration * normal_y + gravity * normal_z
    return maximum(lateral, -lateral) / maximum(vertical, least)


def rollover_term(ratio: Scalar, limit: Scalar, weight: Scalar, maximum: Maximum) -> Scalar:
    """Nearly rolling over: weight (1 + excess) beyond a limit, at once: a hard penalty.

    Args:
        ratio: from `lateral_ratio`.
        limit: that is still safe, e.g. 0.7 of the static stability factor.
        weight: [1/s].
    """
    return weight * (ratio > limit) + weight * maximum(ratio - limit, ratio - ratio)


def effort_term(control: Scalar, weight: Scalar) -> Scalar:
    """Using a control: weight control^2 [1/s]."""
    return weight * control * control


def jerk_term(control: Scalar, before: Scalar, dt: Scalar, weight: Scalar) -> Scalar:
    """Changing a control: weight (change per second)^2.

    Args:
        control, before: in this step and in the one before.
        dt: a step [s].
        weight: [1/s per (1/s)^2].
    """
    rate = (control - before) / dt
    return weight * rate * rate
