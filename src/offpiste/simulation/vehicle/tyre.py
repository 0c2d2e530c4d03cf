"""Tyres: contact with the ground, load, and combined slip by a brush model (compiled scalars).

Pacejka, Tire and Vehicle Dynamics, 3rd ed.: the brush model with parabolic pressure (ch. 3.2, 3.3; Fiala 1954 for the
lateral part) and its transient form with a relaxation length (ch. 7.2, 8.6). Beyond full sliding the force stays
constant, as on soft ground; on asphalt it would decrease.
"""

import numpy as np

from offpiste.native.compilation import PHYSICS
from offpiste.simulation.world.grids import height


@PHYSICS.entry
def dot(a, b):  # type: ignore[no-untyped-def]
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@PHYSICS.entry
def cross(a, b):  # type: ignore[no-untyped-def]
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@PHYSICS.entry
def add(a, b, scale):  # type: ignore[no-untyped-def]
    """Return the vector a + scale b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@PHYSICS.entry
def unit(a):  # type: ignore[no-untyped-def]
    """Return the unit vector."""
    scale = 1.0 / np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + 1e-300)
    return a[0] * scale, a[1] * scale, a[2] * scale


@PHYSICS.entry
def axes(w, x, y, z):  # type: ignore[no-untyped-def]
    """Return the forward, left and up axes in the world frame of a body with quaternion (w, x, y, z)."""
    forward = 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)
    left = 2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)
    up = 2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)
    return forward, left, up


@PHYSICS.entry
def turned(v, forward, left, up):  # type: ignore[no-untyped-def]
    """Return the body-frame vector in the world frame."""
    return (
        v[0] * forward[0] + v[1] * left[0] + v[2] * up[0],
        v[0] * forward[1] + v[1] * left[1] + v[2] * up[1],
        v[0] * forward[2] + v[1] * left[2] + v[2] * up[2],
    )


@PHYSICS.entry
def brush_force(slip_x, slip_y, stiffness_x, stiffness_y, friction, load):  # type: ignore[no-untyped-def]
    """Return the force (forward, left) on the tyre, opposite to slip, at most friction * load (eqs. 3.36, 3.37) [N].

    Args:
        slip_x, slip_y: sliding over rolling velocity, of the tyre over the ground [1].
        stiffness_x, stiffness_y: force over load per slip, at small slip [1].
        friction: largest force over load [1].
        load: [N].
    """
    x, y = stiffness_x * slip_x, stiffness_y * slip_y
    size = np.sqrt(x * x + y * y)
    limit = 3.0 * friction
    if size < 1e-12 or limit <= 0.0:
        return 0.0, 0.0
    s = min(size / limit, 1.0)
    # mu F_z (1 - (1 - s)^3) without its cancellation at small slip
    scale = friction * load * s * (3.0 - s * (3.0 - s)) / size
    return -scale * x, -scale * y


@PHYSICS.entry
def limit_deflection(slip_x, slip_y, stiffness_x, stiffness_y, friction):  # type: ignore[no-untyped-def]
    """Limit the slip to the onset of full sliding, as sliding bristles store no further deflection."""
    x, y = stiffness_x * slip_x, stiffness_y * slip_y
    excess = np.sqrt(x * x + y * y) / (3.0 * friction + 1e-12)
    if excess <= 1.0:
        return slip_x, slip_y
    return slip_x / excess, slip_y / excess


@PHYSICS.entry
def relax(deflection, sliding, rolling, length, dt):  # type: ignore[no-untyped-def]
    """Return the deflection u of the bristles one step later: du/dt = sliding - |rolling| u / length (eq. 7.9).

    The decay is implicit. u / length is the transient slip; at standstill, u is a spring that holds a parked vehicle.

    Args:
        deflection, length: u and relaxation length [m].
        sliding: velocity of the tyre over the ground [m/s].
        rolling: wheel rotation times rolling radius [m/s].
    """
    return (deflection + sliding * dt) / (1.0 + abs(rolling) * dt / length)


@PHYSICS.entry
def standstill_fade(speed, fade_speed):  # type: ignore[no-untyped-def]
    """Return the weight of a stopped tyre's damping: 1 at standstill, 0 from `fade_speed` on (ch. 8.6)."""
    if abs(speed) >= fade_speed:
        return 0.0
    return 0.5 * (1.0 + np.cos(np.pi * speed / fade_speed))


@PHYSICS.entry
def limit_force(x, y, limit):  # type: ignore[no-untyped-def]
    """Limit a force in size [N]."""
    size = np.sqrt(x * x + y * y)
    if size <= limit or size == 0.0:
        return x, y
    return x * limit / size, y * limit / size


@PHYSICS.entry
def ground_under(elevation, x0, y0, resolution, centre, forward, p):  # type: ignore[no-untyped-def]
    """Return the height under the wheel's centre [m] and the unit normal under a tyre, averaged over five points.

    Args:
        elevation, x0, y0, resolution: as in `grids.height`.
        centre, forward: centre [m] and heading of the wheel in the world frame.
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
    """Return the compression of the tyre in its plane, negative in the air, and the point of contact in the world [m].

    Args:
        centre: centre of the wheel [m].
        ground, normal: result of `ground_under`.
        axle: unit vector along the wheel's axle, to the left.
        radius: free radius of the tyre [m].
    """
    radial = unit(add(normal, axle, -dot(normal, axle)))
    upright = max(dot(radial, normal), 0.2)  # limits a wheel that lies flat
    reach = (centre[2] - ground) * normal[2] / upright
    return radius - reach, add(centre, radial, -reach)


@PHYSICS.entry
def normal_load(compression, closing, p):  # type: ignore[no-untyped-def]
    """Return the load of a tyre from spring, damper and rim, at least 0 [N].

    Args:
        compression, closing: compression [m] and its rate [m/s].
    """
    if compression <= 0.0:
        return 0.0
    rim = p.rim_stiffness * max(compression - p.rim_deflection, 0.0)
    return max(p.tyre_stiffness * compression + p.tyre_damping * closing + rim, 0.0)


@PHYSICS.entry
def contact_axes(normal, axle):  # type: ignore[no-untyped-def]
    """Return the forward and left axes of a tyre in the contact plane, in the world frame."""
    forward = unit(cross(axle, normal))
    return forward, cross(normal, forward)
