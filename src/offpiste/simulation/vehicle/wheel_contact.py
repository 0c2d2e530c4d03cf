"""Contact of a wheel with the ground: contact point, compression of the tyre, and load (compiled scalars)."""

import numpy as np

from offpiste.compilation import PHYSICS
from offpiste.simulation.vehicle.vectors import add, cross, dot, unit
from offpiste.simulation.world.surface import height


@PHYSICS.entry
def ground_under(elevation, x0, y0, resolution, centre, forward, p):  # type: ignore[no-untyped-def]
    """Effective plane under a tyre: five heights, averaged as the tyre envelops unevenness.

    Args:
        elevation, x0, y0, resolution: as in `surface.height`.
        centre: centre of the wheel, world frame [m].
        forward: heading of the wheel, world frame.

    Returns:
        height of the plane under the centre [m]; its unit normal, world frame.
    """
    length = np.sqrt(forward[0] * forward[0] + forward[1] * forward[1]) + 1e-9
    c, s = forward[0] / length, forward[1] / length
    a, b = p.envelope_length, 0.5 * p.tyre_width
    x, y = centre[0], centre[1]
    middle = height(elevation, x0, y0, resolution, x, y)
    front = height(elevation, x0, y0, resolution, x + a * c, y + a * s)
    back = height(elevation, x0, y0, resolution, x - a * c, y - a * s)
    left = height(elevation, x0, y0, resolution, x - b * s, y + b * c)
    right = height(elevation, x0, y0, resolution, x + b * s, y - b * c)
    along, across = (front - back) / (2.0 * a), (left - right) / (2.0 * b)
    normal = unit((-along * c + across * s, -along * s - across * c, 1.0))
    return (2.0 * middle + front + back + left + right) / 6.0, normal


@PHYSICS.entry
def touch(centre, ground, normal, axle, radius):  # type: ignore[no-untyped-def]
    """Compression of the tyre along its plane [m], negative in the air, and the point of contact, world frame.

    Args:
        centre: centre of the wheel [m].
        ground: height of the plane under the centre [m].
        normal: unit normal of that plane.
        axle: unit vector of the wheel's spin, to the left.
        radius: free radius of the tyre [m].
    """
    radial = unit(add(normal, axle, -dot(normal, axle)))
    upright = max(dot(radial, normal), 0.2)  # a wheel that lies flat has no tread on the ground
    reach = (centre[2] - ground) * normal[2] / upright
    return radius - reach, add(centre, radial, -reach)


@PHYSICS.entry
def normal_load(compression, closing, p):  # type: ignore[no-untyped-def]
    """Load of a tyre: spring, damper and rim, never pulling [N].

    Args:
        compression: compression of the tyre [m].
        closing: rate of the compression [m/s].
    """
    if compression <= 0.0:
        return 0.0
    rim = p.rim_stiffness * max(compression - p.rim_deflection, 0.0)
    return max(p.tyre_stiffness * compression + p.tyre_damping * closing + rim, 0.0)


@PHYSICS.entry
def contact_axes(normal, axle):  # type: ignore[no-untyped-def]
    """Forward and left of a tyre in the contact plane, world frame."""
    forward = unit(cross(axle, normal))
    return forward, cross(normal, forward)
