"""Faults within single signals: isolated spikes, 16-bit counters below zero, degrees that are counted."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

from offpiste.rig.channels import Wrap
from offpiste.rig.labels import are_since_1970

_SPIKE: Final = 8.0
"""A spike stands out from its neighbours by this many times what 95 % of the samples do."""
PERIODS: Final = (65536.0, 6553.6, 655.36)
"""Periods of 16-bit counters, whole or in tenths or hundredths."""
MAX_SPIKES: Final = 0.02
"""More than this share of the samples are no isolated spikes."""


COUNTED_DEGREES: Final = 1e-7
"""Degrees in which GPS receivers and autopilots count latitude and longitude, as integers."""
_RADIAN: Final = float(np.rad2deg(1.0))
"""In degrees."""
_EACH: Final = (COUNTED_DEGREES, _RADIAN)
"""What one of a latitude may be, besides a degree [deg]."""
_FARTHEST: Final = 0.02
"""No vehicle drives as far within a log [rad]: 130 km."""


def find_spikes(values: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Samples that leave their neighbours for one or two samples and come back; values are finite.

    They stand out from the running median of seven by `_SPIKE` times what 95 % of the samples do, and by more than
    half of what the middle 99 % of all values span, or of the others: bumps and switched signals do not.
    """
    none = np.zeros(len(values), dtype=bool)
    if len(values) < 50 or len(np.unique(values[:: max(len(values) // 1000, 1)])) <= 4:
        return none
    away = np.abs(values - median_filter(values, 7, mode="mirror"))
    apart = away > _SPIKE * np.percentile(away, 95)
    # Many spikes would be part of what all values span: then what the others span counts.
    spikes: Bool[np.ndarray, " n"] = none
    for usual in (values, values[~apart]):
        spikes = apart & (away > _half_span(usual))
        if spikes.any():
            break
    # The largest hide the others, which are as plain if no usual value is like them.
    while (more := apart & (away > _half_span(values[~spikes]))).sum() > spikes.sum():
        low, high = values[~more].min(), values[~more].max()
        if ((values[more] >= low) & (values[more] <= high)).any():
            break
        spikes = more
    return spikes if 0 < spikes.mean() <= MAX_SPIKES else none


def find_wrap(raw: Float[np.ndarray, " n"]) -> Wrap | None:
    """Wrap of a 16-bit counter below zero; None where there is none.

    Its values keep to two bands with most of the period empty between them, none exceeds the period, and less a period
    the upper band continues the lower one. Either may hold most of the samples. Values are finite.
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
            return Wrap(above=_round(ordered[widest] + space[widest] / 2), period=period)
    return None


def degrees_each(latitude: Float[np.ndarray, " n"], longitude: Float[np.ndarray, " n"]) -> float:
    """What one of latitude and longitude is in degrees: `COUNTED_DEGREES`, a radian, or 1.

    Read as degrees, integers of the first would not be on earth, and radians would be at sea, off Africa.
    """
    known = [raw[np.isfinite(raw) & (raw != 0)] for raw in (latitude, longitude)]  # since the first fix
    if not all(map(len, known)):
        return 1.0
    usual = [float(np.median(np.abs(raw))) for raw in known]
    within = [[middle <= most / each for middle, most in zip(usual, (90, 180), strict=True)] for each in _EACH]
    counted, in_radians = map(all, within)
    if counted and min(usual) > 360 and not any((raw % 1).any() for raw in known):
        return COUNTED_DEGREES
    return _RADIAN if in_radians and max(map(np.ptp, known)) < _FARTHEST else 1.0


def are_off_the_earth(latitude: Float[np.ndarray, " n"], longitude: Float[np.ndarray, " n"]) -> bool:
    """Whether most latitudes or longitudes are larger than degrees are, as minutes of arc."""
    known = [np.abs(raw[np.isfinite(raw) & (raw != 0)]) for raw in (latitude, longitude)]
    return any(len(sizes) > 0 and np.median(sizes) > most for sizes, most in zip(known, (90, 360), strict=True))


def unrolled(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Angles that jump from one end of a full turn to the other, unwrapped; all else as it is."""
    for turn in (2 * np.pi, 360.0):
        jumps = np.abs(np.diff(values))
        if len(values) > 1 and np.ptp(values) <= 1.001 * turn and jumps.max() > 0.9 * turn:
            return np.unwrap(values, period=turn)
    return values


def _half_span(values: Float[np.ndarray, " n"]) -> float:
    """Half of what the middle 99 % of some values span; infinite for none."""
    return float(np.ptp(np.percentile(values, (0.5, 99.5)))) / 2 if len(values) else np.inf


def _round(value: float) -> float:
    """Two digits: a threshold in the middle of nowhere needs no more."""
    return float(f"{value:.2g}")


def is_clock(column: Float[np.ndarray, " n"]) -> bool:
    """Whether a column only ever grows, as a time or a sequence number does; whole seconds since 1970 repeat."""
    finite = column[np.isfinite(column)]
    known = finite[finite != 0]  # a clock may not be set yet
    if len(known) > 10 and are_since_1970(known):
        return bool(np.mean(np.diff(known) >= 0) > 0.9)
    return len(finite) > 10 and bool((np.diff(finite) > 0).all())
