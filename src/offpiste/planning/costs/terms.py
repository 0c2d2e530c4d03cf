"""The cost terms that ship: path, speed, overspeed, slide, hazard, rollover, effort, jerk (`costs.declaration`)."""

from offpiste.planning.costs.declaration import Function, Parameter, Scalar, cost_term, quantity


@quantity
def lateral_acceleration(vy: Scalar, vy_before: Scalar, dt: Scalar, vx: Scalar, yaw_rate: Scalar) -> Scalar:
    """Acceleration of the pose point to the left, in the horizontal plane [m/s^2]."""
    return (vy - vy_before) / dt + vx * yaw_rate


@quantity
def normal_x(cos_yaw: Scalar, world_normal_x: Scalar, sin_yaw: Scalar, world_normal_y: Scalar) -> Scalar:
    """Ground's normal turned by minus yaw; above 0 where the ground falls ahead."""
    return cos_yaw * world_normal_x + sin_yaw * world_normal_y


@quantity
def normal_y(cos_yaw: Scalar, world_normal_y: Scalar, sin_yaw: Scalar, world_normal_x: Scalar) -> Scalar:
    """Ground's normal turned by minus yaw; above 0 where the ground falls to the left."""
    return cos_yaw * world_normal_y - sin_yaw * world_normal_x


@quantity
def normal_z(world_normal_z: Scalar) -> Scalar:
    """Ground's normal, upwards."""
    return world_normal_z


@quantity
def speed_along(
    cos_yaw: Scalar, sin_yaw: Scalar, vx: Scalar, vy: Scalar, direction_x: Scalar, direction_y: Scalar
) -> Scalar:
    """Speed along the course [m/s].

    Args:
        cos_yaw, sin_yaw: of the heading.
        vx, vy: of the body [m/s].
        direction_x, direction_y: of the course, a unit vector in the world.
    """
    return (cos_yaw * vx - sin_yaw * vy) * direction_x + (sin_yaw * vx + cos_yaw * vy) * direction_y


@quantity
def stray_from_course(
    cos_yaw: Scalar, sin_yaw: Scalar, direction_x: Scalar, direction_y: Scalar, stray_along: Scalar,
    stray_across: Scalar, maximum: Function,
) -> Scalar:  # fmt: skip
    """How far errors of position reach away from the course [m]; 0 where the risk counts none.

    At most: as if the largest errors along and across the heading came together.

    Args:
        cos_yaw, sin_yaw: of the heading.
        direction_x, direction_y: of the course, a unit vector in the world.
        stray_along, stray_across: reach along and across the heading [m].
        maximum: of two numbers.
    """
    ahead, aside = cos_yaw * direction_x + sin_yaw * direction_y, cos_yaw * direction_y - sin_yaw * direction_x
    return stray_along * maximum(aside, -aside) + stray_across * maximum(ahead, -ahead)


@quantity
def lateral_ratio(
    lateral_acceleration: Scalar,
    normal_y: Scalar,
    normal_z: Scalar,
    gravity: Scalar,
    least_vertical: Scalar,
    maximum: Function,
) -> Scalar:
    """Lateral over vertical acceleration as the vehicle feels them on its ground.

    A vehicle rolls over where this passes track width / (2 height of the centre of mass), its static stability factor
    (NHTSA, 2000). The specific force in the body's lateral plane is (a_y, g); along the ground's lateral tangent and
    its normal it has the parts a_y n_z - g n_y and a_y n_y + g n_z. On level ground the ratio is |a_y| / g, at rest on
    a side slope its rise over run. The ground's curvature along the path is left out.

    Args:
        lateral_acceleration: a_y [m/s^2].
        normal_y, normal_z: of the ground, turned by minus yaw.
        gravity: [m/s^2].
        least_vertical: vertical acceleration counts as this at least, so that lifting off is expensive [m/s^2].
    """
    lateral = lateral_acceleration * normal_z - gravity * normal_y
    vertical = lateral_acceleration * normal_y + gravity * normal_z
    return maximum(lateral, -lateral) / maximum(vertical, least_vertical)


@cost_term("path", weight=1.0, unit="1/s per m^2")
def path_term(distance: Scalar, stray_from_course: Scalar, weight: Scalar) -> Scalar:
    """Distance from the course, and what errors may add to it: weight (distance + stray)^2.

    Args:
        distance: to the path [m].
        stray_from_course: see there [m].
        weight: [1/s per m^2].
    """
    off = distance + stray_from_course
    return weight * off * off


@cost_term("speed", weight=1.0, unit="1/s per (m/s)^2")
def speed_term(speed_along: Scalar, target_speed: Scalar, weight: Scalar) -> Scalar:
    """Error of the speed along the course: weight (speed_along - target_speed)^2.

    Args:
        speed_along, target_speed: [m/s].
        weight: [1/s per (m/s)^2].
    """
    return weight * (speed_along - target_speed) * (speed_along - target_speed)


@cost_term("overspeed", weight=2.0, unit="1/s per (m/s)^2")
def overspeed_term(vx: Scalar, speed_limit: Scalar, weight: Scalar, maximum: Function) -> Scalar:
    """Speed above what rough ground allows: weight (|vx| - speed_limit)^2 above the limit.

    Args:
        vx, speed_limit: [m/s]; the limit may be infinite.
        weight: [1/s per (m/s)^2].
    """
    above = maximum(maximum(vx, -vx) - speed_limit, vx - vx)
    return weight * above * above


@cost_term("slide", weight=1.0, unit="1/s per (m/s)^2")
def slide_term(vy: Scalar, weight: Scalar) -> Scalar:
    """Velocity to the side: weight vy^2. A vehicle that slides may spin, or trip over firm ground and roll over.

    Args:
        vy: [m/s]; in a bend that grips it is small.
        weight: [1/s per (m/s)^2].
    """
    return weight * vy * vy


@cost_term("hazard", unit="1/s")
def hazard_term(hazard: Scalar) -> Scalar:
    """Obstacles, steep and unknown ground under the wheels: the map's own cost [1/s]."""
    return hazard


@cost_term(
    "rollover",
    weight=1000.0,
    unit="1/s",
    parameters={"lateral_limit": Parameter(0.7, "1"), "least_vertical": Parameter(1.0, "m/s^2")},
)
def rollover_term(lateral_ratio: Scalar, lateral_limit: Scalar, weight: Scalar, maximum: Function) -> Scalar:
    """Nearness to rolling over: weight (1 + excess) beyond a limit, a hard penalty.

    Args:
        lateral_ratio: see there.
        lateral_limit: ratio that is still safe, e.g. 0.7 of the static stability factor.
        weight: [1/s].
    """
    excess = maximum(lateral_ratio - lateral_limit, lateral_ratio - lateral_ratio)
    return weight * (lateral_ratio > lateral_limit) + weight * excess


@cost_term("effort", weight=(0.0, 0.2, 0.2), unit="1/s")
def effort_term(control: Scalar, weight: Scalar) -> Scalar:
    """Use of a control: weight control^2 [1/s]."""
    return weight * control * control


@cost_term("jerk", weight=(0.02, 0.02, 0.05), unit="1/s per (1/s)^2")
def jerk_term(control: Scalar, control_before: Scalar, dt: Scalar, weight: Scalar) -> Scalar:
    """Change of a control: weight (change per second)^2.

    Args:
        control, control_before: in this step and in the one before.
        dt: a step [s].
        weight: [1/s per (1/s)^2].
    """
    rate = (control - control_before) / dt
    return weight * rate * rate
