"""Numbers of controls that go both ways from a middle above zero: servo pulses, and counts of a potentiometer."""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.signal_faults import find_spikes

_PULSES: Final = (900.0, 2100.0)
"""Widths of the pulses that servos and speed controllers take [us]."""
_MIDDLE_PULSE: Final = 1500.0
_LEAST_PULSE: Final = 1000.0
_BEGINS: Final = 1080.0
"""A speed controller that only drives is at its least pulse when it is released, and so up to here at times [us]."""
FULL_PULSE: Final = 2000.0
"""Pulse of full throttle [us]."""
_COUNTS: Final = (100.0, 180.0, 255.0, 1023.0, 4095.0, 65535.0)
"""Ends of ranges from zero whose middle is straight ahead."""
_REACHED: Final = 0.4
"""Least share of a whole range that a drive covers ..."""
_CENTRAL: Final = (0.35, 0.65)
"""... and where its median lies in it."""


def are_pulses(values: Float[np.ndarray, " n"], *, named: bool) -> bool:
    """Whether numbers are widths of pulses [us].

    Args:
        named: whether their unit or name says so; else they must lie on both sides of the middle pulse.
    """
    low, high = np.percentile(values, (0.5, 99.5))
    inside = low >= _PULSES[0] and high <= _PULSES[1] and high - low > 20
    return bool(inside and (named or low < _MIDDLE_PULSE - 20 < _MIDDLE_PULSE + 20 < high))


def steering_middle(
    values: Float[np.ndarray, " n"], *, named: bool, straight: float | None = None
) -> tuple[float, float, str] | None:
    """Number straight ahead, that of full lock beyond it, and why; None for numbers on both sides of zero.

    Args:
        values: as recorded, finite.
        named: whether unit or name say that they are pulses.
        straight: number at which the vehicle goes straight, where the motion shows it: servos are trimmed.
    """
    around = _usual_middle(values, named=named)
    if around is None or straight is None:
        return around
    turned = values[~find_spikes(values)]
    reach = float(np.abs(turned - straight).max())
    seen = f"{turned.min():.4g}..{turned.max():.4g} seen"
    return straight, reach, f"by the motion {straight:.4g} straight ahead, and full lock {reach:.4g} from it; {seen}"


def _usual_middle(values: Float[np.ndarray, " n"], *, named: bool) -> tuple[float, float, str] | None:
    """The same by the numbers alone."""
    low, high = (float(end) for end in np.percentile(values, (0.5, 99.5)))
    seen = f"{low:.4g}..{high:.4g} seen"
    if are_pulses(values, named=named):
        turned = values[~find_spikes(values)]
        seen = f"{turned.min():.4g}..{turned.max():.4g} seen"
        reach = float(np.abs(turned - _MIDDLE_PULSE).max())
        words = f"pulses, {_MIDDLE_PULSE:g} straight ahead and full lock {reach:.4g} from it; {seen}"
        return _MIDDLE_PULSE, reach, words
    median = float(np.median(values))
    for full in _COUNTS:
        central = _CENTRAL[0] * full <= median <= _CENTRAL[1] * full
        if low >= 0 and high <= 1.02 * full and high - low >= _REACHED * full and central:
            return full / 2, full / 2, f"of 0..{full:g}, {seen}"
    if low <= 0:
        return None
    return (low + high) / 2, (high - low) / 2, f"{seen}: is their middle straight ahead?"


def pulse_at_rest(values: Float[np.ndarray, " n"]) -> float:
    """The pulse of a speed controller that is released [us]: the middle one, or the least where it begins there."""
    return _MIDDLE_PULSE if float(np.percentile(values, 1)) > _BEGINS else _LEAST_PULSE
