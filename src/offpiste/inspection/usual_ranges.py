"""Raw value ranges of controls in logs: pedals and steering or throttle with a centre.

The centre is above zero for servo pulses and potentiometer counts.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from offpiste.inspection.signal_faults import find_spikes
from offpiste.rig.channels import ChannelSource, unit_factor
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.labels import VOCABULARY

RANGES: Final[Mapping[str, Any]] = VOCABULARY["draft"]["ranges"]
"""Usual ranges of raw values (see vocabulary.toml)."""
_PRESSED: Final = 0.45
"""Minimum share of the full scale that a drive reaches, for ranges from zero."""
_SLACK: Final = 0.02
_NOTHING: Final = 1e-6
"""Maximum share of the largest value that counts as zero, e.g. after a decaying filter."""
_REACHED: Final = 0.4
"""Minimum share of the range covered by a drive."""
_CENTRAL: Final = (0.35, 0.65)
"""Range of the median, as a share of the range."""


def held_range(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the minimum and maximum of a pedal without spikes; presses may be too rare for percentiles."""
    held = median_filter(values, size=5)
    return float(held.min()), float(held.max())


def seen_range(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the range of a pedal in this drive, from rest to the strongest sustained press.

    Outliers beyond the rest position are ignored, up to 0.5% of the values.
    """
    (low, high), (least, most) = held_range(values), np.percentile(values, (0.5, 99.5))
    least, most = (low, float(most)) if rests_high(values) else (float(least), high)
    tiny = _NOTHING * max(abs(least), abs(most))
    return (0.0 if abs(least) < tiny else least), (0.0 if abs(most) < tiny else most)


def largest_size(values: Float[np.ndarray, " n"]) -> float:
    """Return the maximum magnitude without spikes."""
    usual, largest = float(np.percentile(np.abs(values), 99)), float(np.abs(values).max())
    return largest if largest < 1.2 * usual else usual


def full_scale(largest: float) -> float:
    """Return the common full-scale value for the maximum of a drive; 0 if none matches."""
    return next((full for full in RANGES["full_scales"] if _PRESSED * full <= largest <= (1 + _SLACK) * full), 0.0)


def whole_range(values: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """Return the range 0..full or -full..full (triggers) of a pedal that rests at one end; None otherwise.

    Args:
        values: finite values.
    """
    low, high = held_range(values)
    for full in RANGES["full_scales"]:
        slack = _SLACK * full
        if abs(low) <= slack and _PRESSED * full <= high <= full + slack:
            return 0.0, full
        ends = low <= -full + slack, high >= full - slack
        rests = float(np.mean(values <= -full + slack)), float(np.mean(values >= full - slack))
        inside = -full - slack <= low < -slack and slack < high <= full + slack
        if inside and any(end and rest > 0.1 for end, rest in zip(ends, rests, strict=True)):
            return -full, full
    return None


def rests_high(values: Float[np.ndarray, " n"]) -> bool | None:
    """Return whether a pedal is released at its upper end; None if it rests at neither end."""
    low, high = np.percentile(values, (0.5, 99.5))
    if not high - low > _SLACK * np.ptp(held_range(values)):  # rarely pressed
        low, high = held_range(values)
    at_low, at_high = (float(np.mean(np.abs(values - end) <= _SLACK * (high - low))) for end in (low, high))
    if max(at_low, at_high) < 0.1:
        return None
    return at_high > at_low


def rests_between(values: Float[np.ndarray, " n"], middle: float = 0.0) -> bool:
    """Return whether a pedal has a centre at which it is released.

    It may be at full throttle up to about twice as often; a trigger only passes its centre.
    """
    low, high = (end - middle for end in held_range(values))
    reach, slack = max(-low, high), _SLACK * (high - low)
    if min(-low, high) <= 0.05 * reach:
        return False
    around = values - middle
    near = np.mean(np.abs(around) <= 0.05 * reach)
    return bool(near >= 0.5 * max(np.mean(around <= low + slack), np.mean(around >= high - slack)))


def is_signed(values: Float[np.ndarray, " n"]) -> bool:
    """Return whether a pedal is signed: often near zero and not at rest at its lower end."""
    low, high = np.percentile(values, (0.5, 99.5))
    largest = max(-low, high)
    if min(-low, high) < 0.05 * largest:
        return False
    near = float(np.mean(np.abs(values) <= 0.05 * largest))
    at_low = float(np.mean(values <= low + 0.02 * largest))
    evenly = 0.1 * largest / (high - low)
    return bool(near >= evenly / 4 and at_low < 0.3)


def scaled_to_unit(
    name: str, source: ChannelSource, span: tuple[float, float], *, turned: bool = False
) -> tuple[Edit, ...]:
    """Return the edits that map a pedal's converted values from a range to 0..1, or to 1..0.

    Args:
        span: minimum and maximum as currently converted by the rig.
        turned: whether to map the minimum to 1 and the maximum to 0.
    """
    low, high = span
    if not high > low:
        return ()  # constant except for a few samples
    per_unit = source.sign * unit_factor(name, source.unit)
    # value = sign * (raw * scale + offset) * unit, so (value - low) / (high - low) has the same form.
    factor, start = (-1 / (high - low), high) if turned else (1 / (high - low), low)
    wanted = {"scale": factor * source.scale, "offset": factor * (source.offset - start / per_unit)}
    now = {"scale": source.scale, "offset": source.offset}
    return tuple(
        Edit(f"channels.{name}.{key}", rounded(value) + 0.0) for key, value in wanted.items() if value != now[key]
    )


def are_pulses(values: Float[np.ndarray, " n"], *, named: bool) -> bool:
    """Return whether values are pulse widths [us].

    Args:
        named: whether unit or name indicate pulses; otherwise values must lie on both sides of the centre pulse.
    """
    low, high = np.percentile(values, (0.5, 99.5))
    (shortest, longest), middle = RANGES["pulses"], RANGES["middle_pulse"]
    inside = low >= shortest and high <= longest and high - low > 20
    return bool(inside and (named or low < middle - 20 < middle + 20 < high))


def steering_middle(
    values: Float[np.ndarray, " n"], *, named: bool, straight: float | None = None
) -> tuple[float, float, str] | None:
    """Return the value straight ahead, the distance to full lock, and the reason; None for values of both signs.

    Args:
        values: finite recorded values.
        named: whether unit or name indicate pulses.
        straight: value straight ahead according to the motion, as servos are trimmed.
    """
    low, high = (float(end) for end in np.percentile(values, (0.5, 99.5)))
    seen, pulses = f"{low:.4g}..{high:.4g} seen", are_pulses(values, named=named)
    half = float(np.median(values))

    def is_usual(full: float) -> bool:
        central = _CENTRAL[0] * full <= half <= _CENTRAL[1] * full
        return low >= 0 and high <= 1.02 * full and high - low >= _REACHED * full and central

    full = next(filter(is_usual, RANGES["middles"]), 0.0)
    if low == high or not (pulses or full or low > 0):  # a constant steering shows no full lock
        return None
    if pulses or straight is not None:
        centre, by = (RANGES["middle_pulse"], "pulses,") if straight is None else (straight, "by the motion")
        turned = values[~find_spikes(values)]
        reach, seen = float(np.abs(turned - centre).max()), f"{turned.min():.4g}..{turned.max():.4g} seen"
        return centre, reach, f"{by} {centre:.4g} straight ahead and full lock {reach:.4g} from it; {seen}"
    if full:
        return full / 2, full / 2, f"of 0..{full:g}, {seen}"
    return (low + high) / 2, (high - low) / 2, f"{seen}: is their middle straight ahead?"


def pulse_at_rest(values: Float[np.ndarray, " n"], *, named: bool) -> float | None:
    """Return the released pulse of a speed controller [us]; None if values are no pulses (`are_pulses`).

    It is the centre, or the minimum if that is more frequent.
    """
    if not are_pulses(values, named=named):
        return None
    middle, begins = RANGES["middle_pulse"], RANGES["begins"]
    near = float(np.mean(np.abs(values - middle) <= 0.05 * (RANGES["full_pulse"] - middle)))
    forward_only = np.percentile(values, 1) <= begins and np.mean(values <= begins) > near
    return float(RANGES["least_pulse"] if forward_only else middle)
