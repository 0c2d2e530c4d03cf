"""Rows of a log that are read: those whose stamps increase, and, of a table, those that a slower sensor fills.

Of a table, the parts of one quantity may stand in rows of their own, a message each, which are brought together.
"""

from bisect import bisect_left
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

_SLOWER: Final = 0.1
"""Share of the rows that a slower sensor leaves empty, at least."""
_TOGETHER: Final = 0.01
"""Messages by which the parts of one quantity are sent are less than this apart [s]."""
_CHANCE: Final = 0.05
"""Share of the samples of a quantity up to which its parts share a row by chance."""
_RUNS: Final = 20
"""Runs of empty rows, and of others, that show how evenly they come."""


def between_samples(empty: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Empty rows that lie between the samples of a slower sensor.

    Runs of empty rows, and of rows in between, are then as long as most of them, within a factor of two. What is empty
    for longer was lost; where runs are of any length, rows were lost at random, and none of them is expected to be.
    """
    none = np.zeros(len(empty), bool)
    if not len(empty) or empty.mean() < _SLOWER:
        return none
    begin = np.flatnonzero(np.diff(empty, prepend=~empty[0]))
    length, is_empty = np.diff(begin, append=len(empty)), empty[begin]
    longest = []
    for kind in (False, True):
        runs = length[1:-1][is_empty[1:-1] == kind]
        if len(runs) < _RUNS:
            return none
        longest.append(2 * float(np.median(runs)) + 1)
        if np.percentile(runs, 90) > longest[-1]:
            return none
    return np.asarray(empty & np.repeat(length <= longest[-1], length))


def brought_together(time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """The same rows, those of the first column with what the others hold at nearly the same time.

    As of a CAN bus, on which latitude and longitude come in messages of their own. Rows whose numbers stand in another
    one are empty then. Where rows hold all of them, other than by chance, nothing is changed.

    Args:
        time: stamps, in any order [s].
    """
    if values.shape[1] < 2:
        return values
    known = np.isfinite(values) & np.isfinite(time)[:, None]
    fewest = known.sum(axis=0).min()
    if fewest < 2 or known.all(axis=1).sum() > _CHANCE * fewest:
        return values
    result = np.full_like(values, np.nan)
    at = np.flatnonzero(known[:, 0])
    for column, there in enumerate(known.T):
        rows = np.flatnonzero(there)[np.argsort(time[there], kind="stable")]
        after = np.searchsorted(time[rows], time[at]).clip(1, len(rows) - 1)
        earlier = time[at] - time[rows[after - 1]] < time[rows[after]] - time[at]
        near = rows[after - earlier]
        result[at, column] = np.where(np.abs(time[near] - time[at]) < _TOGETHER, values[near, column], np.nan)
    return result


def increasing(time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Rows to keep so that stamps increase, as many as can be: a stamp that is far off costs its own row alone.

    Where a clock was set back, as many rows are left if those before are kept as if those behind are: then it is those
    before, each later than all before it.

    Args:
        time: stamps without NaN [s].
    """
    if not len(time):
        return np.zeros(0, dtype=bool)
    later = np.append(True, time[1:] > np.maximum.accumulate(time)[:-1])
    if len(time) - later.sum() == (np.diff(time) <= 0).sum():
        return later  # each step back costs a row at least
    earlier = np.append(time[:-1] < np.minimum.accumulate(time[::-1])[::-1][1:], True)
    return max(later, earlier, _longest(time), key=np.sum)


def _longest(time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Longest increasing subsequence, by the least stamp with which one of each length ends."""
    ends: list[float] = []
    last: list[int] = []
    before = np.full(len(time), -1)
    for row, stamp in enumerate(time.tolist()):
        length = bisect_left(ends, stamp)
        if length:
            before[row] = last[length - 1]
        if length == len(ends):
            ends.append(stamp)
            last.append(row)
        elif stamp < ends[length]:
            ends[length], last[length] = stamp, row
    kept = np.zeros(len(time), dtype=bool)
    row = last[-1]
    while row >= 0:
        kept[row] = True
        row = before[row]
    return kept
