"""Passes of wheels over ground cells; each pass has its own feature sets (docs/method.md)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Int32

PAUSE = 10.0  # time without contact after which the next contact with a cell begins a new pass [s]


@dataclass(frozen=True)
class Passes:
    """Passes of a vehicle over cells, in the order of first contact."""

    # column and row on the world-aligned grid; the cell's lower corner is at (column, row) resolutions
    cell: Int[np.ndarray, "P 2"]
    # time at which the vehicle was farthest from the cell since the previous pass, or the start [s]
    approach: Float[np.ndarray, " P"]
    contact: Float[np.ndarray, " P"]  # time at which the first wheel enters the cell [s]
    end: Float[np.ndarray, " P"]  # time at which the next pass over the cell begins; infinite for the last one [s]
    index: Int32[np.ndarray, "N 4"]  # pass under each wheel at each row; -1 at unknown positions


def find_passes(
    time: Float[np.ndarray, " N"],
    xy: Float[np.ndarray, "N 2"],
    wheels: Float[np.ndarray, "N 4 2"],
    *,
    resolution: float,
    jumps: Float[np.ndarray, "j 2"] | None = None,
) -> Passes:
    """Find the passes of a drive over cells of `resolution` [m].

    Args:
        time, xy, wheels: increasing times of the rows [s], and positions in the world frame, NaN where unknown [m].
        jumps: times before and after each jump of the poses, across which no pass continues [s].
    """
    jumps = np.zeros((0, 2)) if jumps is None else jumps
    known = np.isfinite(wheels).all(axis=(1, 2)) & np.isfinite(xy).all(axis=1)
    for earlier, later in jumps:
        known &= (time <= earlier) | (time >= later)
    grid = np.floor(np.where(known[:, None, None], wheels, 0.0) / resolution).astype(np.int64)
    rows = np.repeat(np.flatnonzero(known), 4)
    cells, cell = np.unique(grid[known].reshape(-1, 2), axis=0, return_inverse=True)
    cell = cell.reshape(-1)

    # Contacts of each cell in the order of time; the first one after a pause begins a pass.
    order = np.lexsort((rows, cell))
    touched, when = cell[order], time[rows[order]]
    begins = np.ones(len(order), bool)
    begins[1:] = (np.diff(touched) != 0) | (np.diff(when) > PAUSE)
    begins[1:] |= np.diff(np.searchsorted(jumps[:, 1], when, side="right")) != 0
    number = np.cumsum(begins) - 1
    contact, of = when[begins], touched[begins]
    again = np.append(of[1:] == of[:-1], False)
    end = np.where(again, np.append(contact[1:], np.inf), np.inf)
    last = when[np.append(np.flatnonzero(begins)[1:] - 1, len(when) - 1)] if len(when) else when
    before = np.where(np.append(False, again[:-1]), np.append(-np.inf, last[:-1]), -np.inf)

    sort = np.argsort(contact, kind="stable")
    of, contact, end, before = of[sort], contact[sort], end[sort], before[sort]
    index = np.full((len(time), 4), -1, np.int32)
    flat = np.empty(len(order), np.int64)
    flat[order] = np.argsort(sort)[number]
    index[known] = flat.reshape(-1, 4)
    approach = _farthest(time[known], xy[known], (cells[of] + 0.5) * resolution, before, contact)
    edges = np.concatenate(([-np.inf], jumps[:, 1], [np.inf]))
    stretch = np.searchsorted(jumps[:, 1], contact, side="right")
    approach, end = np.maximum(approach, edges[stretch]), np.minimum(end, edges[stretch + 1])
    return Passes(cells[of], approach, contact, end, index)


def _farthest(
    time: Float[np.ndarray, " n"],
    xy: Float[np.ndarray, "n 2"],
    centre: Float[np.ndarray, "P 2"],
    after: Float[np.ndarray, " P"],
    before: Float[np.ndarray, " P"],
) -> Float[np.ndarray, " P"]:
    """Return the last time at which the vehicle was farthest from each cell, between two times."""
    first = np.searchsorted(time, after, side="left")
    stop = np.searchsorted(time, before, side="right")
    result = np.empty(len(centre))
    for p in range(len(centre)):
        # On a first pass this is the start of the drive; only returns need the search.
        if not np.isfinite(after[p]):
            result[p] = time[0]
            continue
        away = np.square(xy[first[p] : stop[p]] - centre[p]).sum(axis=1)
        result[p] = time[first[p] + len(away) - 1 - int(np.argmax(away[::-1]))]
    return result
