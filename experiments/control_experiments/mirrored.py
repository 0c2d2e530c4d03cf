"""Every training drive once more as in a mirror: left and right are alike to a vehicle.

Not to one whose steering is off the centre: the proving ground's is not.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from offpiste.conventions import WHEELS
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import part_number
from offpiste.dataset.store import Dataset, StoredDrive

MIRRORED_STATE: Final = np.array([1, -1, -1, 1, -1, -1], np.float32)
"""px, py, yaw, vx, vy, yaw rate (`conventions.STATE`), mirrored in the world's x axis."""

MIRRORED_NORMAL: Final = np.array([1, -1, 1], np.float32)
OTHER_SIDE: Final = [WHEELS.index(name) for name in ("front-right", "front-left", "rear-right", "rear-left")]
TO_THE_SIDE: Final = ("steer", "steer_rate")
"""Controls and actuators that change their sign."""


def with_mirrored(dataset: Dataset) -> Dataset:
    """The dataset and, of each drive that trains, its mirror image; maps and what validates and tests stay."""
    controls = _signs(tuple(control.name for control in dataset.rig.controls))
    actuators = _signs(tuple(actuator.name for actuator in dataset.rig.actuators))
    images = [
        replace(
            drive,
            name=f"{drive.name} mirrored",
            rows=mirrored(drive.rows, controls, actuators),
            load_map=None,
            snapshots=None,
        )
        for drive in dataset.drives
        if _trains(drive)
    ]
    return replace(dataset, drives=(*dataset.drives, *images))


def mirrored(rows: Rows, controls: np.ndarray, actuators: np.ndarray) -> Rows:
    """Rows of the same drive in a mirror.

    Args:
        controls, actuators: 1 or -1 for each column.
    """
    cells = rows.cells
    return replace(
        rows,
        origin=rows.origin * MIRRORED_STATE[:2],
        state=rows.state * MIRRORED_STATE,
        state_causal=rows.state_causal * MIRRORED_STATE,
        actuators=rows.actuators * actuators,
        actuators_causal=rows.actuators_causal * actuators,
        control=rows.control * controls,
        control_causal=rows.control_causal * controls,
        normal=rows.normal[:, :, OTHER_SIDE] * MIRRORED_NORMAL,
        normal_causal=rows.normal_causal * MIRRORED_NORMAL,
        cells=None if cells is None else replace(cells, index=cells.index[:, OTHER_SIDE]),
    )


def _signs(columns: tuple[str, ...]) -> np.ndarray:
    return np.array([-1 if name in TO_THE_SIDE else 1 for name in columns], np.float32)


def _trains(drive: StoredDrive) -> bool:
    return bool((drive.part == part_number("train")).all())
