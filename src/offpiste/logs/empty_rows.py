"""Rows of a table that a slower sensor leaves empty: they are no fault, and what it really lost is known from them."""

from typing import Final

import numpy as np
from jaxtyping import Bool

_SLOWER: Final = 0.1
"""Share of the rows that a slower sensor leaves empty, at least."""
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
