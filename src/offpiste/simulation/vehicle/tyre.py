"""Combined slip of a tyre: a brush of elastic bristles on ground of one friction (compiled scalars).

Pacejka, Tire and Vehicle Dynamics, 3rd ed.: the brush model with parabolic pressure (ch. 3.2, 3.3; Fiala 1954 in its
lateral part) and its transient form with a relaxation length (ch. 7.2, 8.6). Forces stay on a plateau beyond full
sliding, as they do on soft ground; a tyre on asphalt would lose force again.
"""

import numpy as np

from offpiste.compilation import PHYSICS


@PHYSICS.entry
def brush_force(slip_x, slip_y, stiffness_x, stiffness_y, friction, load):  # type: ignore[no-untyped-def]
    """Force on the tyre in the contact plane (eqs. 3.36, 3.37): opposes slip, at most friction * load.

    Args:
        slip_x, slip_y: sliding velocity over rolling velocity [1]; forwards and left, of the tyre over the ground.
        stiffness_x, stiffness_y: force over load at small slip [1].
        friction: largest force over load [1].
        load: [N].

    Returns:
        forwards, left [N].
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
    """Slip shrunk to where the whole patch slides: bristles that slide store no more deflection."""
    x, y = stiffness_x * slip_x, stiffness_y * slip_y
    excess = np.sqrt(x * x + y * y) / (3.0 * friction + 1e-12)
    if excess <= 1.0:
        return slip_x, slip_y
    return slip_x / excess, slip_y / excess


@PHYSICS.entry
def relax(deflection, sliding, rolling, length, dt):  # type: ignore[no-untyped-def]
    """Deflection of the bristles one step later, implicit in its decay (eq. 7.9): stable at any speed.

    du/dt = sliding - |rolling| u / length; u / length is the transient slip. At standstill u is a spring that
    holds a parked vehicle.

    Args:
        deflection: u [m].
        sliding: velocity of the tyre over the ground [m/s].
        rolling: wheel rotation times rolling radius [m/s].
        length: relaxation length [m].
    """
    return (deflection + sliding * dt) / (1.0 + abs(rolling) * dt / length)


@PHYSICS.entry
def standstill_fade(speed, fade_speed):  # type: ignore[no-untyped-def]
    """1 at standstill, 0 from `fade_speed` on: damping of a stopped tyre (ch. 8.6)."""
    if abs(speed) >= fade_speed:
        return 0.0
    return 0.5 * (1.0 + np.cos(np.pi * speed / fade_speed))


@PHYSICS.entry
def limit_force(x, y, limit):  # type: ignore[no-untyped-def]
    """A force shortened to `limit` [N]."""
    size = np.sqrt(x * x + y * y)
    if size <= limit or size == 0.0:
        return x, y
    return x * limit / size, y * limit / size
