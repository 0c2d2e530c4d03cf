"""Statistics of stamps: rate, jitter, losses, repeats, steps back, gaps."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.recorded_log import rising

_SINGLE: Final = 0.25
"""Share of intervals of one period where up to three in four samples are lost at random."""


@dataclass(frozen=True)
class Timing:
    """Statistics of a topic's stamps.

    Attributes:
        rate: samples a second, losses and gaps left aside [Hz]; NaN for fewer than three samples.
        jitter: half the spread from the 5th to the 95th percentile of the intervals, over the median interval.
        lost: share of samples missing by that rate, gaps left aside.
        repeated, backward: counts of stamps equal to, or before, the one before.
        start, end, gaps: of the stamps that reading keeps; gaps are intervals longer than the clock's `max_gap` and ten
            times the median one [s], and where they begin.
        dropped: stamps that reading drops since they repeat or go back.
    """

    start: float
    end: float
    count: int
    rate: float
    jitter: float
    lost: float
    repeated: int
    backward: int
    gaps: tuple[tuple[float, float], ...]
    dropped: int


def timing(time: Float[np.ndarray, " n"], *, max_gap: float) -> Timing:
    """Statistics of stamps [s]; those that are not finite are left out."""
    time = time[np.isfinite(time)]
    step = np.diff(time)
    forward = step[step > 0]
    kept = rising(time)
    start, end = (float(kept[0]), float(kept[-1])) if len(kept) else (np.nan, np.nan)
    repeated, backward, dropped = int((step == 0).sum()), int((step < 0).sum()), len(time) - len(kept)
    if len(forward) < 2:
        return Timing(start, end, len(time), np.nan, 0.0, 0.0, repeated, backward, (), dropped)
    low, typical, high = np.percentile(forward, (5, 50, 95))
    # Where samples arrive in bunches or at odd times only the mean gives the rate; elsewhere losses would bias it.
    short = forward[forward <= max(max_gap, 10 * typical)]
    lost = _lost(short / typical) if repeated < 0.02 * len(time) else None
    if lost is None and repeated == 0 and (more := _lost_half(short)) is not None:
        typical, lost = more
    single = forward[np.round(forward / typical) == 1]
    interval = float(np.mean(single if lost is not None else step[(step >= 0) & (step <= max(max_gap, 10 * typical))]))
    step = np.diff(kept)
    gaps = tuple((float(kept[i]), float(step[i])) for i in np.flatnonzero(step > max(max_gap, 10 * interval)))
    jitter = (high - low) / 2 / interval
    return Timing(start, end, len(time), 1 / interval, jitter, lost or 0.0, repeated, backward, gaps, dropped)


def _lost(periods: Float[np.ndarray, " n"]) -> float | None:
    """Share of samples missing, from the intervals in periods; None where they are no whole numbers of them."""
    whole = np.round(periods)
    # A message that is sent twice at once is no period: hardly any log lacks three in four samples.
    if len(periods) < 50 or np.mean(np.abs(periods - whole)) > 0.1 or np.mean(periods) > 1 / _SINGLE:
        return None
    return float(np.sum(whole - 1) / max(np.sum(whole), 1))


def _lost_half(interval: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """Period [s] and share lost where so many samples are missing that the median interval is not one period."""
    for period in (np.median(interval) / 2, np.median(interval) / 3):
        lost = _lost(interval / period)
        # Stamps in steps of a clock are whole numbers of them as well, and hardly ever one step apart.
        if lost is not None and np.mean(np.round(interval / period) == 1) > _SINGLE:
            return float(period), lost
    return None
