"""Statistics of stamps: rate, jitter, losses, repeats, backward steps and gaps."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.recorded_log import rising

_SINGLE: Final = 0.25
"""Minimum share of single-period intervals; up to three in four samples may be lost at random."""


@dataclass(frozen=True)
class Timing:
    """Statistics of a topic's stamps.

    Attributes:
        rate: samples per second excluding losses and gaps [Hz]; NaN for fewer than three samples.
        jitter: half the spread from the 5th to the 95th percentile of the intervals, divided by the sample interval.
        lost: share of samples missing at this rate, excluding gaps.
        repeated, backward: number of stamps equal to, or earlier than, the previous one.
        start, end, gaps: statistics of the stamps kept on reading [s]; gaps are (start, length) of intervals longer
            than the clock's `max_gap` and ten times the sample interval.
        dropped: number of stamps dropped on reading as they repeat or go back.
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
    """Return statistics of stamps [s], ignoring non-finite ones."""
    time = time[np.isfinite(time)]
    step = np.diff(time)
    forward = step[step > 0]
    kept = rising(time)
    start, end = (float(kept[0]), float(kept[-1])) if len(kept) else (np.nan, np.nan)
    repeated, backward, dropped = int((step == 0).sum()), int((step < 0).sum()), len(time) - len(kept)
    if len(forward) < 2:
        return Timing(start, end, len(time), np.nan, 0.0, 0.0, repeated, backward, (), dropped)
    low, typical, high = np.percentile(forward, (5, 50, 95))
    # For samples in bunches or at irregular times, only the mean gives the rate; otherwise losses would bias it.
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
    """Return the share of missing samples from intervals in periods; None if these are not integers."""
    whole = np.round(periods)
    # The interval between duplicate messages is not a period: a loss of three in four samples is implausible.
    if len(periods) < 50 or np.mean(np.abs(periods - whole)) > 0.1 or np.mean(periods) > 1 / _SINGLE:
        return None
    return float(np.sum(whole - 1) / max(np.sum(whole), 1))


def _lost_half(interval: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """Return the period [s] and share lost if the median interval exceeds one period due to losses."""
    for period in (np.median(interval) / 2, np.median(interval) / 3):
        lost = _lost(interval / period)
        # Stamps with a coarse clock are integer multiples of its tick as well, but rarely one tick apart.
        if lost is not None and np.mean(np.round(interval / period) == 1) > _SINGLE:
            return float(period), lost
    return None
