"""Quaternions (xyzw), planar rotations and local polynomials, of rows in NumPy."""

import math
from typing import Final

import numpy as np
from jaxtyping import Float, Int

_BLOCK: Final = 2**17
"""Samples of windows that are fitted at once, about 60 bytes each."""


def planar_body_from_world(
    vectors: Float[np.ndarray, "*B 2"], yaw: Float[np.ndarray, "*#B"]
) -> Float[np.ndarray, "*B 2"]:
    """Horizontal world vectors in the planar body frame, ahead and to the left: turned by minus yaw."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack((cos * x + sin * y, cos * y - sin * x), axis=-1)


def rotation_from_quaternion(quaternion: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 3 3"]:
    """Rotation matrices `world_from_body` of quaternions xyzw of any length; NaN for zeros."""
    # SciPy's matrices differ in the last bit, which would change simulated logs, and it refuses NaN and zeros.
    x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def rotation_of_one(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """`rotation_from_quaternion` of one that is not zero, to the bit, in a tenth of the time."""
    x, y, z, w = quaternion.tolist()
    length = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        )
    )


def same_sign(quaternion: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 4"]:
    """The same rotations, each with the sign that lies nearer to the one before: q and -q are one rotation.

    What lies between two of them is then the short way round, and never zero.
    """
    flips = np.einsum("Nk,Nk->N", quaternion[1:], quaternion[:-1]) < 0
    return quaternion * np.where(np.append(False, np.logical_xor.accumulate(flips)), -1.0, 1.0)[:, None]


def yaw_from_quaternion(quaternion: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, " N"]:
    """Heading of the body's x axis in the horizontal plane, unwrapped over the rows [rad]."""
    forward = rotation_from_quaternion(quaternion)[:, :, 0]
    return np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))


def yaw_rate_from_body_rates(
    quaternion: Float[np.ndarray, "N 4"], rates_body: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, " N"]:
    """d(yaw)/dt from the gyro: (q sin(roll) + r cos(roll)) / cos(pitch), Euler angles z-y-x [rad/s]."""
    rotation = rotation_from_quaternion(quaternion)
    roll = np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2])
    cos_pitch = np.hypot(rotation[:, 2, 1], rotation[:, 2, 2])
    return (rates_body[:, 1] * np.sin(roll) + rates_body[:, 2] * np.cos(roll)) / np.maximum(cos_pitch, 1e-6)


def local_polynomial(
    time: Float[np.ndarray, " n"],
    values: Float[np.ndarray, "n k"],
    at: Float[np.ndarray, " N"],
    *,
    window: float,
    causal: bool,
    degree: int = 2,
) -> tuple[Float[np.ndarray, "N k"], Float[np.ndarray, "N k"]]:
    """Least-squares polynomials through the samples around each moment, evaluated there.

    The Savitzky-Golay idea (Anal. Chem. 36, 1964) on stamps that need not be even.

    Args:
        time: stamps, strictly increasing.
        at: moments to estimate at.
        window: span of the samples used, [at - window/2, at + window/2], or [at - window, at] if `causal`.
        causal: look only at samples stamped at or before each moment.
        degree: of the polynomial.

    Returns:
        values and their first derivatives; NaN where a window holds fewer than degree + 2 samples, or where these
        span less than a third of it or lie further than that from the moment (a burst of stamps or the edge of a gap
        would be extrapolated to anything).
    """
    first, last = (at - window, at) if causal else (at - window / 2, at + window / 2)
    begin = np.searchsorted(time, first - 1e-9, side="left")
    end = np.searchsorted(time, last + 1e-9, side="right")
    found, rate = np.empty((2, len(at), values.shape[1]))
    widths = np.maximum(end - begin, 1)
    # Rows of like widths together: one dense place (a burst of stamps) would widen the windows of all others.
    rows = np.argsort(widths, kind="stable")
    while len(rows):
        block = widths[rows[: max(_BLOCK // int(widths[rows[0]]), 1)]]
        count = max(int(np.searchsorted(block * np.arange(1, len(block) + 1), _BLOCK, side="right")), 1)
        block, rows = rows[:count], rows[count:]
        fits = _fits(time, values, at[block], begin[block], end[block], window, degree)
        found[block], rate[block] = fits[:, 0], fits[:, 1] / window
    return found, rate


def _fits(
    time: Float[np.ndarray, " n"],
    values: Float[np.ndarray, "n k"],
    at: Float[np.ndarray, " N"],
    begin: Int[np.ndarray, " N"],
    end: Int[np.ndarray, " N"],
    window: float,
    degree: int,
) -> Float[np.ndarray, "N c k"]:
    """Coefficients of the polynomials through the samples from `begin` to before `end`, in time / window from `at`."""
    index = begin[:, None] + np.arange(max(int((end - begin).max()), 1))
    inside = index < end[:, None]
    index = np.minimum(index, len(time) - 1)

    offset = np.where(inside, (time[index] - at[:, None]) / window, 0.0)
    powers = np.repeat(inside[:, :, None].astype(float), degree + 1, axis=2)
    for power in range(1, degree + 1):  # NumPy's own power takes thirty times as long
        powers[:, :, power] = powers[:, :, power - 1] * offset
    enough = inside.sum(axis=1) >= degree + 2
    with np.errstate(invalid="ignore"):
        enough &= np.where(inside, offset, -np.inf).max(axis=1) - np.where(inside, offset, np.inf).min(axis=1) > 1 / 3
    enough &= np.where(inside, np.abs(offset), np.inf).min(axis=1) < 1 / 3
    normal = np.einsum("Nwi,Nwj->Nij", powers, powers)
    normal[~enough] = np.eye(degree + 1)
    moments = np.einsum("Nwi,Nwk->Nik", powers, values[index])
    coefficients = np.linalg.solve(normal, moments)
    coefficients[~enough] = np.nan
    return coefficients


_EQUATOR: Final = 6_378_137.0
_FLATTENING: Final = 1 / 298.257223563
"""WGS 84's ellipsoid: its radius at the equator [m], and how much flatter it is at the poles."""
LARGEST_DEGREES: Final = (90.0, 360.0)
"""Latitude and longitude that are places on the earth, by size; a longitude counts to 180 or to 360."""
_GRID: Final = 0.01
"""Tangent planes touch the ellipsoid at multiples of this [degrees]: a log and a part of it have the same."""


_CREEPS: Final = 0.1
"""Speed below which a turn rate hardly says how the wheels are turned [m/s]."""


def bicycle_angle(
    yaw_rate: Float[np.ndarray, "*n"], speed: Float[np.ndarray, "*n"], wheelbase: float
) -> Float[np.ndarray, "*n"]:
    """Angle of the front wheels of a bicycle that turns at a rate, at a speed, without slip [rad].

    Almost a quarter turn to either side where it turns on the spot, which no bicycle does; next to nothing where it
    stands and hardly turns, as slower speeds than `_CREEPS` count as that.

    Args:
        yaw_rate: to the left [rad/s].
        speed: of the rear axle, negative backwards [m/s].
        wheelbase: [m].
    """
    return np.arctan2(wheelbase * yaw_rate * np.where(speed < 0, -1.0, 1.0), np.maximum(np.abs(speed), _CREEPS))


def local_from_geographic(
    place: Float[np.ndarray, "n c"], origin: tuple[float, float] | None = None
) -> Float[np.ndarray, "n c"]:
    """East and north of an origin, from latitude and longitude on WGS 84's ellipsoid.

    Distances on a plane that touches there: 5 km away they are 0.1 % off at 50 degrees of latitude.

    Args:
        place: latitude, longitude [degrees] and, if there is one, height [m].
        origin: latitude and longitude of x = y = 0; None: those of a point near the first known place.

    Returns:
        x east, y north and the height as it was [m]; NaN where a place is none.
    """
    # Receivers write 0, 0 until they know where they are.
    known = (np.abs(place[:, :2]) <= LARGEST_DEGREES).all(axis=1) & (place[:, :2] != 0).any(axis=1)
    local = np.full_like(place, np.nan, dtype=np.float64)
    local[:, 2:] = place[:, 2:]
    if not known.any():
        return local
    touched = np.round(place[known.argmax(), :2] / _GRID) * _GRID if origin is None else np.array(origin)
    squared = _FLATTENING * (2 - _FLATTENING)
    bent = 1 - squared * np.sin(np.deg2rad(touched[0])) ** 2
    along = _EQUATOR * (1 - squared) / bent**1.5
    across = _EQUATOR / np.sqrt(bent) * np.cos(np.deg2rad(touched[0]))
    north, east = np.deg2rad(place[known, 0] - touched[0]), np.deg2rad((place[known, 1] - touched[1] + 180) % 360 - 180)
    local[known, 0], local[known, 1] = across * east, along * north
    return local
