"""Numbers of controls that go both ways from a middle above zero: servo pulses, and counts of a potentiometer."""

from typing import Final

import numpy as np
from jaxtyping import Float

_PULSES: Final = (900.0, 2100.0)
"""Widths of the pulses that servos and speed controllers take [us]."""
_MIDDLE_PULSE: Final = 1500.0
_LEAST_PULSE: Final = 1000.0
_BEGINS: Final = 1080.0
"""A speed controller that only drives is at its least pulse when it is released, and so up to here at times [us]."""
FULL_PULSE: Final = 2000.0
"""Pulse of full throttle [us]."""
_COUNTS: Final = ((0.0, 1.0), (0.0, 100.0), (0.0, 180.0), (0.0, 255.0), (0.0, 1023.0), (0.0, 4095.0), (0.0, 65535.0))
"""Whole ranges with the middle in the middle."""
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


def steering_middle(values: Float[np.ndarray, " n"], *, named: bool) -> tuple[float, float, str] | None:
    """Number straight ahead, that of full lock beyond it, and why; None for numbers on both sides of zero.

    Args:
        values: as recorded, finite.
        named: whether unit or name say that they are pulses.
    """
    low, high = (float(end) for end in np.percentile(values, (0.5, 99.5)))
    if low <= 0 and high > 0 and not _is_count(low, high, values):
        return None
    seen = f"{low:.4g}..{high:.4g} seen"
    if are_pulses(values, named=named):
        reach = float(np.abs(np.percentile(values, (0.1, 99.9)) - _MIDDLE_PULSE).max())
        return (
            _MIDDLE_PULSE,
            reach,
            f"pulses, {_MIDDLE_PULSE:g} straight ahead and full lock {reach:.4g} from it; {seen}",
        )
    for least, most in _COUNTS:
        if most >= 1 and least <= low <= high <= 1.02 * most and _is_within(low, high, values, least, most):
            return (least + most) / 2, (most - least) / 2, f"of {least:g}..{most:g}, {seen}"
    if low <= 0:
        return None
    return (low + high) / 2, (high - low) / 2, f"{seen}: is their middle straight ahead?"


def pulse_at_rest(values: Float[np.ndarray, " n"]) -> float:
    """The pulse of a speed controller that is released [us]: the middle one, or the least where it begins there."""
    return _MIDDLE_PULSE if float(np.percentile(values, 1)) > _BEGINS else _LEAST_PULSE


def _is_count(low: float, high: float, values: Float[np.ndarray, " n"]) -> bool:
    return low == 0 and high > 1.05 and any(_is_within(low, high, values, *ends) for ends in _COUNTS)


def _is_within(low: float, high: float, values: Float[np.ndarray, " n"], least: float, most: float) -> bool:
    middle = (float(np.median(values)) - least) / (most - least)
    return high <= 1.02 * most and high - low >= _REACHED * (most - least) and _CENTRAL[0] <= middle <= _CENTRAL[1]
