"""Cost terms: path, speed, overspeed, slide, hazard, rollover, effort and jerk (`costs.declaration`)."""

from offpiste.planning.costs.declaration import Function, Parameter, Scalar, cost_term, quantity


@quantity
def lateral_acceleration(vy: Scalar, vy_before: Scalar, dt: Scalar, vx: Scalar, yaw_rate: Scalar) -> Scalar:
    """Return the horizontal acceleration of the pose point to the left [m/s^2]."""
    return (vy - vy_before) / dt + vx * yaw_rate


@quantity
def normal_x(cos_yaw: Scalar, world_normal_x: Scalar, sin_yaw: Scalar, world_normal_y: Scalar) -> Scalar:
    """Return the normal's forward component; positive where the ground falls ahead."""
    return cos_yaw * world_normal_x + sin_yaw * world_normal_y


@quantity
def normal_y(cos_yaw: Scalar, world_normal_y: Scalar, sin_yaw: Scalar, world_normal_x: Scalar) -> Scalar:
    """Return the normal's left component; positive where the ground falls to the left."""
    return cos_yaw * world_normal_y - sin_yaw * world_normal_x


@quantity
def normal_z(world_normal_z: Scalar) -> Scalar:
    """Return the normal's vertical component."""
    return world_normal_z


@quantity
def speed_along(
    cos_yaw: Scalar, sin_yaw: Scalar, vx: Scalar, vy: Scalar, direction_x: Scalar, direction_y: Scalar
) -> Scalar:
    """Return the speed along the course [m/s]; the direction is a unit vector in the world frame."""
    return (cos_yaw * vx - sin_yaw * vy) * direction_x + (sin_yaw * vx + cos_yaw * vy) * direction_y


@quantity
def position_margin(
    cos_yaw: Scalar, sin_yaw: Scalar, direction_x: Scalar, direction_y: Scalar, margin_along: Scalar,
    margin_across: Scalar, maximum: Function,
) -> Scalar:  # fmt: skip
    """Return the margin for position errors across the course [m].

    It is an upper bound: margins along and across the heading are assumed to occur together.
    """
    ahead, aside = cos_yaw * direction_x + sin_yaw * direction_y, cos_yaw * direction_y - sin_yaw * direction_x
    return margin_along * maximum(aside, -aside) + margin_across * maximum(ahead, -ahead)


@quantity
def lateral_ratio(
    lateral_acceleration: Scalar,
    normal_y: Scalar,
    normal_z: Scalar,
    gravity: Scalar,
    least_vertical: Scalar,
    maximum: Function,
) -> Scalar:
    """Return the ratio of lateral to vertical specific force in the frame of the ground.

    A vehicle rolls over if this exceeds track width / (2 height of the centre of mass), its static stability factor
    (NHTSA, 2000). The specific force in the body's lateral plane is (a_y, g); its components along the ground's
    lateral tangent and normal are a_y n_z - g n_y and a_y n_y + g n_z. On level ground the ratio is |a_y| / g, at rest
    on a side slope its rise over run. The curvature of the ground is neglected.

    Args:
        lateral_acceleration: a_y [m/s^2].
        least_vertical: lower bound of the vertical component, so that lifting off is expensive [m/s^2].
    """
    lateral = lateral_acceleration * normal_z - gravity * normal_y
    vertical = lateral_acceleration * normal_y + gravity * normal_z
    return maximum(lateral, -lateral) / maximum(vertical, least_vertical)


@cost_term("path", weight=1.0, unit="1/s per m^2")
def path_term(distance: Scalar, position_margin: Scalar, weight: Scalar) -> Scalar:
    """Penalise the distance from the course: weight (distance + position_margin)^2."""
    off = distance + position_margin
    return weight * off * off


@cost_term("speed", weight=1.0, unit="1/s per (m/s)^2")
def speed_term(speed_along: Scalar, target_speed: Scalar, weight: Scalar) -> Scalar:
    """Penalise the error of the speed along the course: weight (speed_along - target_speed)^2."""
    return weight * (speed_along - target_speed) * (speed_along - target_speed)


@cost_term("overspeed", weight=2.0, unit="1/s per (m/s)^2")
def overspeed_term(vx: Scalar, speed_limit: Scalar, weight: Scalar, maximum: Function) -> Scalar:
    """Penalise speed above the limit of rough ground, which may be infinite: weight (|vx| - speed_limit)^2."""
    above = maximum(maximum(vx, -vx) - speed_limit, vx - vx)
    return weight * above * above


@cost_term("slide", weight=1.0, unit="1/s per (m/s)^2")
def slide_term(vy: Scalar, weight: Scalar) -> Scalar:
    """Penalise lateral velocity: weight vy^2. A sliding vehicle may spin, or trip over firm ground and roll over."""
    return weight * vy * vy


@cost_term("hazard", unit="1/s")
def hazard_term(hazard: Scalar) -> Scalar:
    """Return the cost of obstacles, steep and unknown ground under the wheels [1/s]."""
    return hazard


@cost_term(
    "rollover",
    weight=1000.0,
    unit="1/s",
    parameters={"lateral_limit": Parameter(0.7, "1"), "least_vertical": Parameter(1.0, "m/s^2")},
)
def rollover_term(lateral_ratio: Scalar, lateral_limit: Scalar, weight: Scalar, maximum: Function) -> Scalar:
    """Penalise the danger of rollover: weight (1 + excess) beyond a limit.

    Args:
        lateral_limit: safe ratio, such as 0.7 of the static stability factor.
    """
    excess = maximum(lateral_ratio - lateral_limit, lateral_ratio - lateral_ratio)
    return weight * (lateral_ratio > lateral_limit) + weight * excess


@cost_term("effort", weight=(0.0, 0.2, 0.2), unit="1/s")
def effort_term(control: Scalar, weight: Scalar) -> Scalar:
    """Penalise the use of a control: weight control^2."""
    return weight * control * control


@cost_term("jerk", weight=(0.02, 0.02, 0.05), unit="1/s per (1/s)^2")
def jerk_term(control: Scalar, control_before: Scalar, dt: Scalar, weight: Scalar) -> Scalar:
    """Penalise the change of a control: weight (change per second)^2."""
    rate = (control - control_before) / dt
    return weight * rate * rate
