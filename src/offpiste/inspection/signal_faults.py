"""Faults of single signals: isolated spikes, wrapped 16-bit counters, and integer or radian coordinates."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

from offpiste.rig.channels import Wrap
from offpiste.rig.labels import are_since_1970

_SPIKE: Final = 8.0
"""Minimum ratio of a spike's deviation from its neighbours to the 95th percentile of the deviations."""
PERIODS: Final = (65536.0, 6553.6, 655.36)
"""Periods of 16-bit counters in units of 1, 0.1 and 0.01."""
MAX_SPIKES: Final = 0.02
"""Maximum share of isolated spikes among the samples."""


COUNTED_DEGREES: Final = 1e-7
"""Resolution of integer latitudes and longitudes from GPS receivers and autopilots [deg]."""
_RADIAN: Final = float(np.rad2deg(1.0))
"""One radian [deg]."""
_EACH: Final = (COUNTED_DEGREES, _RADIAN)
"""Units of latitude and longitude besides the degree [deg]."""
_FARTHEST: Final = 0.02
"""Maximum extent of a log [rad]; 130 km."""


def find_spikes(values: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return a mask of spikes of one or two samples in finite values.

    Spikes deviate from the running median of seven by more than `_SPIKE` times the 95th percentile of the deviations
    and by more than half the span of the middle 99 % of the values, unlike bumps and switched signals.
    """
    none = np.zeros(len(values), dtype=bool)
    if len(values) < 50 or len(np.unique(values[:: max(len(values) // 1000, 1)])) <= 4:
        return none
    away = np.abs(values - median_filter(values, 7, mode="mirror"))
    apart = away > _SPIKE * np.percentile(away, 95)
    # Many spikes would widen the span of all values, so test against the span of the others as well.
    spikes: Bool[np.ndarray, " n"] = none
    for usual in (values, values[~apart]):
        spikes = apart & (away > _half_span(usual))
        if spikes.any():
            break
    # Large spikes hide smaller ones, which are accepted if all lie outside the usual range.
    while (more := apart & (away > _half_span(values[~spikes]))).sum() > spikes.sum():
        low, high = values[~more].min(), values[~more].max()
        if ((values[more] >= low) & (values[more] <= high)).any():
            break
        spikes = more
    return spikes if 0 < spikes.mean() <= MAX_SPIKES else none


def find_wrap(raw: Float[np.ndarray, " n"]) -> Wrap | None:
    """Return the wrap of a negative 16-bit counter in finite values, or None.

    The values form two bands separated by most of the period, none exceeds the period, and the upper band continues the
    lower one after subtraction of the period. Either band may hold most samples.
    """
    high = float(raw.max())
    for period in PERIODS:
        if not 0.9 * period < high <= period or raw.min() < -0.01 * period:
            continue
        ordered = np.sort(raw)
        space = np.diff(ordered)
        widest = int(space.argmax())
        if space[widest] < 0.5 * period:
            continue
        lower, upper = ordered[: widest + 1], ordered[widest + 1 :] - period
        spread = np.ptp(lower) > 0 and len(lower) > max(10, 0.002 * len(raw))
        if spread and abs(upper[0]) <= max(2 * np.ptp(lower), 0.05 * period) and lower[0] - upper[-1] < 0.02 * period:
            return Wrap(above=float(f"{ordered[widest] + space[widest] / 2:.2g}"), period=period)
    return None


def degrees_each(latitude: Float[np.ndarray, " n"], longitude: Float[np.ndarray, " n"]) -> float:
    """Return the unit of latitude and longitude in degrees: `COUNTED_DEGREES`, one radian, or 1.

    Read as degrees, such integers exceed the valid range, and radians lie in the sea off Africa.
    """
    known = [raw[np.isfinite(raw) & (raw != 0)] for raw in (latitude, longitude)]  # ignore samples before the first fix
    if not all(map(len, known)):
        return 1.0
    usual = [float(np.median(np.abs(raw))) for raw in known]
    within = [[middle <= most / each for middle, most in zip(usual, (90, 180), strict=True)] for each in _EACH]
    counted, in_radians = map(all, within)
    if counted and min(usual) > 360 and not any((raw % 1).any() for raw in known):
        return COUNTED_DEGREES
    return _RADIAN if in_radians and max(map(np.ptp, known)) < _FARTHEST else 1.0


def are_off_the_earth(latitude: Float[np.ndarray, " n"], longitude: Float[np.ndarray, " n"]) -> bool:
    """Return whether most latitudes or longitudes exceed the range of degrees, e.g. as minutes of arc."""
    known = [np.abs(raw[np.isfinite(raw) & (raw != 0)]) for raw in (latitude, longitude)]
    return any(len(sizes) > 0 and np.median(sizes) > most for sizes, most in zip(known, (90, 360), strict=True))


def unrolled(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Unwrap angles that jump by a full turn; return other values unchanged."""
    for turn in (2 * np.pi, 360.0):
        jumps = np.abs(np.diff(values))
        if len(values) > 1 and np.ptp(values) <= 1.001 * turn and jumps.max() > 0.9 * turn:
            return np.unwrap(values, period=turn)
    return values


def _half_span(values: Float[np.ndarray, " n"]) -> float:
    """Return half the span of the middle 99 % of values; infinity for no values."""
    return float(np.ptp(np.percentile(values, (0.5, 99.5)))) / 2 if len(values) else np.inf


def is_clock(column: Float[np.ndarray, " n"]) -> bool:
    """Return whether a column is monotonic like a time or sequence number; whole seconds since 1970 may repeat."""
    finite = column[np.isfinite(column)]
    known = finite[finite != 0]  # ignore samples before the clock is set
    if len(known) > 10 and are_since_1970(known):
        return bool(np.mean(np.diff(known) >= 0) > 0.9)
    return len(finite) > 10 and bool((np.diff(finite) > 0).all())
