"""16-bit counters below zero: values that are a period too large."""

import numpy as np
from jaxtyping import Float

from offpiste.inspection.ranges import PERIODS
from offpiste.rig.channels import Wrap


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


def _round(value: float) -> float:
    """Two digits: a threshold in the middle of nowhere needs no more."""
    return float(f"{value:.2g}")
