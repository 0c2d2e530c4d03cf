"""The report of a dataset's visual features as numbers, by drive and in all (`offpiste.dataset.coverage`)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from offpiste.conventions import DT, FEATURE_SETS
from offpiste.dataset import coverage
from offpiste.dataset.cells import Cells
from offpiste.dataset.passes import Passes, find_passes
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.mapping.settings import VoxelSettings
from offpiste.mapping.terrain import wheel_places
from offpiste.rig import Rig

STRIDE = 5
"""Rows between two looks at where the vehicle was: 0.1 s."""


@dataclass(frozen=True)
class Rates:
    """Valid rates by feature set, of a drive or of all.

    Attributes:
        name: of the drive.
        cells: how many, each counted once a pass.
        share: of all cells.
        of_hindsight: of those that are valid in hindsight, which is 1 there, as in the paper's table.
        in_reach: of those from which the vehicle was as far away as the set says; NaN where that cannot be told.
    """

    name: str
    cells: int
    share: Float[np.ndarray, " D"]
    of_hindsight: Float[np.ndarray, " D"]
    in_reach: Float[np.ndarray, " D"]


@dataclass(frozen=True)
class Covered:
    """What the visual features of a dataset cover.

    Attributes:
        drives: with such features.
        whole: of all of them together.
        quartiles: of the distances at which features were observed [m].
        apart: differences between sets, relative to the features' ranges between the 1st and the 99th percentile.
        apart_of_total: the same relative to the total range of values, as the paper has it.
        unrelated: of cells that have nothing to do with each other, as in `apart.length`.
        contacts: of wheels with cells, by how often the place was passed before; empty where that cannot be told.
    """

    drives: tuple[Rates, ...]
    whole: Rates
    quartiles: Float[np.ndarray, "D 3"]
    apart: coverage.Differences
    apart_of_total: coverage.Differences
    unrelated: float
    contacts: Int[np.ndarray, " K"]


def covered(dataset: Dataset, *, seed: int = 0) -> Covered | None:
    """The numbers of a dataset; None if no drive of it has features by distance.

    Args:
        seed: of the pairs of cells that have nothing to do with each other.
    """
    found = [(drive, drive.rows.cells) for drive in dataset.drives if by_distance(drive.rows.cells)]
    cells = [c for _, c in found if c is not None]
    if not sum(c.valid.shape[1] for c in cells):
        return None
    passes = [passes_of(drive, dataset.rig) for drive, _ in found]
    reached = [_reached(drive, p) for (drive, _), p in zip(found, passes, strict=True)]
    drives = [_rates(d.name, [c], [r]) for (d, _), c, r in zip(found, cells, reached, strict=True)]
    span, total = coverage.feature_range(cells), coverage.feature_range(cells, (0.0, 100.0))
    counts = [coverage.contacts_by_pass(p) for p in passes if p is not None]
    contacts = np.zeros(max((len(c) for c in counts), default=0), np.int64)
    for count in counts:
        contacts[: len(count)] += count
    return Covered(
        tuple(drives),
        _rates("all", cells, reached),
        coverage.observation_quartiles(cells),
        coverage.differences(cells, span),
        coverage.differences(cells, total),
        coverage.unrelated(cells, span, np.random.default_rng(seed)),
        contacts if all(p is not None for p in passes) else contacts[:0],
    )


def by_distance(cells: Cells | None) -> bool:
    """Whether these are visual features, with all feature sets."""
    return cells is not None and len(cells.valid) == len(FEATURE_SETS) and cells.features.shape[2] > 0


def passes_of(drive: StoredDrive, rig: Rig) -> Passes | None:
    """The passes that a drive's cells stand for, found again; None where they are not those of the usual map."""
    rows = drive.rows
    xy = path_of(drive)
    wheels = wheel_places(xy, rows.state[:, 2].astype(np.float64), rig.wheel_positions())
    passes = find_passes(rows.time, xy, wheels, resolution=VoxelSettings().size)
    same = rows.cells is not None and np.array_equal(passes.index, rows.cells.index)
    return passes if same else None


def path_of(drive: StoredDrive) -> Float[np.ndarray, "N 2"]:
    """Places of the pose point in the world frame [m]; NaN where unknown."""
    return np.asarray(drive.rows.state[:, :2].astype(np.float64) + drive.rows.origin)


def seconds_of(drive: StoredDrive) -> float:
    """How long it lasts [s]."""
    return len(drive.rows.time) * DT


def _reached(drive: StoredDrive, passes: Passes | None) -> np.ndarray:
    if passes is None:
        assert drive.rows.cells is not None
        return np.zeros_like(drive.rows.cells.valid)
    time, xy = drive.rows.time[::STRIDE], path_of(drive)[::STRIDE]
    return coverage.within_reach(passes, time, xy, VoxelSettings().size)


def _rates(name: str, cells: Sequence[Cells], reached: Sequence[np.ndarray]) -> Rates:
    return Rates(
        name,
        sum(c.valid.shape[1] for c in cells),
        coverage.valid_rates(cells),
        coverage.valid_rates(cells, coverage.in_hindsight(cells)),
        coverage.valid_rates(cells, reached),
    )
