"""What a rollout is given, into the lanes that loops run over, and what it gives out of them."""

from typing import Final

import numpy as np

from offpiste.core.conventions import ACTUATORS
from offpiste.dynamics.kernels.elementary import f4
from offpiste.dynamics.kernels.layout import ABSENT, CONTROLS, LANES
from offpiste.native.compilation import KERNELS

ACTUATED: Final = len(ACTUATORS)
COMMANDED: Final = len(CONTROLS)
GIVEN: Final = COMMANDED + 3 + 1
"""Controls, mean normals, which follow them in the workspace, and the share of unknown ones."""


@KERNELS.inlined
def _into_lanes(values: np.ndarray, block: int, t: int, k: int, row: np.ndarray) -> None:
    """Column k of values [B, T, N] at step t; lanes behind the batch repeat its last window."""
    batch = len(values)
    inside = min(LANES, batch - block * LANES)
    for i in range(inside):
        row[i] = values[block * LANES + i, t, k]
    for i in range(inside, LANES):
        row[i] = values[batch - 1, t, k]


@KERNELS.entry
def pack(
    first: int,
    last: int,
    controls: np.ndarray,
    normals: np.ndarray,
    known: np.ndarray,
    terms: np.ndarray,
    recorded: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Bring what is given of blocks `first` ... `last - 1` into lanes; those behind the batch repeat its last window.

    Args:
        controls: [B, T, U].
        normals, known: of each wheel, in the world frame [B, T, 4, 3], and whether it is [B, T, 4].
        terms: [B, T, N].
        recorded: see `Record`.
        rows: to fill.
    """
    batch, steps, _ = controls.shape
    for block in range(first, last):
        for t in range(steps):
            row = rows[block, t]
            for k in range(COMMANDED):
                if recorded[ACTUATED + k]:
                    _into_lanes(controls, block, t, k, row[k * LANES : (k + 1) * LANES])
                else:
                    row[k * LANES : (k + 1) * LANES] = f4(ABSENT[k])
            for k in range(3):
                for i in range(LANES):
                    four = normals[min(block * LANES + i, batch - 1), t]
                    mean = f4(0.25) * (four[0, k] + four[1, k] + four[2, k] + four[3, k])
                    row[(COMMANDED + k) * LANES + i] = mean
            for i in range(LANES):
                four_known = known[min(block * LANES + i, batch - 1), t]
                count = f4(four_known[0]) + f4(four_known[1]) + f4(four_known[2]) + f4(four_known[3])
                row[(COMMANDED + 3) * LANES + i] = f4(1) - f4(0.25) * count
            for k in range(terms.shape[2]):
                _into_lanes(terms, block, t, k, row[(GIVEN + k) * LANES : (GIVEN + k + 1) * LANES])


@KERNELS.entry
def unpack(first: int, last: int, rows: np.ndarray, values: np.ndarray) -> None:
    """Bring rows [blocks, T, N * LANES] out of their lanes, into [B, T, N]."""
    batch, steps, count = values.shape
    for block in range(first, last):
        for t in range(steps):
            for k in range(count):
                for i in range(min(LANES, batch - block * LANES)):
                    values[block * LANES + i, t, k] = rows[block, t, k * LANES + i]
