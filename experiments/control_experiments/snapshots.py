"""Trained on the map as it was when each window began, not on what it came to hold later.

A snapshot is one window's own, so every window becomes a drive of its own, 5.2 s long, with the ground under its
recorded wheels as the snapshot had it. The same windows with the usual features are the counterpart.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments.control_experiments.data import claim_settings
from experiments.control_experiments.models import trained_seeds
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import write_control
from offpiste.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.ground_truth_features import with_ground_truth
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.errors import RunError
from offpiste.reproduction.gains import MAP, errors_of, evaluation_index, gain, gain_table

ABOUT = (
    "Trained on windows that have a snapshot of the map at their start: on the snapshot at recorded places, or on the "
    "usual features of the same windows. All evaluated on the map at predicted places, against the b of the same "
    "training; 95 % intervals."
)


def snapshots_control(of: Reproduced, out: Path, *, drives: int, seconds: float, seeds: int) -> Path:
    """Extract some drives with snapshots for their training windows too, train on both kinds, evaluate on maps.

    Args:
        drives: how many training drives, evenly spread; all that validate are used.
        seconds: at most one snapshot in so long [s].
        seeds: runs of each model.
    """
    folder = out / "snapshots"
    claim_settings(folder, {"drives": drives, "seconds": seconds})
    logs = {log.stem: log for log in of.logs()}
    parts = {drive.name: PARTS[int(drive.part.max())] for drive in of.dataset.drives}
    training = [name for name, part in parts.items() if part == "train"]
    some = np.unique(np.linspace(0, len(training) - 1, min(drives, len(training))).astype(int))
    chosen = [training[i] for i in some] + [name for name, part in parts.items() if part == "validation"]
    if of.dataset.split.kind != "drives":
        raise RunError("needs a split by drives", where=of.folder, how="reproduce with --split drives")
    kept = SnapshotSettings(seconds, parts=("train", "validation"))
    dataset = make_dataset(
        [logs[name] for name in chosen],
        of.dataset.rig,
        folder / "dataset.zarr",
        split=of.split_for(folder),
        pca=of.pca,
        snapshots=kept,
        force=True,
    )
    # Each window is a drive with one start, its row 10: no stride. Fewer windows than usual, so smaller batches.
    config = replace(of.member("cf").config(of.size, 0, "cpu"), stride=1, batch=64)
    on_map, standard_model = (own_drives(dataset, read) for read in (read_on_snapshot, read_as_stored))
    windows = Windows(of.dataset, "test")
    index, gains = evaluation_index(windows, MAP, of.size.stride), []
    for case, data, models in (
        ("trained on snapshots", on_map, ("b", "cf")),
        ("trained on the same windows", standard_model, ("b", "cf", "dc")),
    ):
        place = folder / case.replace(" ", "-")
        errors = {
            model: [
                errors_of(run, windows, index, MAP, scale=of.scale, kept=place / "evaluated")
                for run in trained_seeds(data, replace(config, model=model), place / "runs", seeds)
            ]
            for model in models
        }
        gains += [gain(case, model, errors[model], errors["b"], MAP) for model in models[1:]]
    table = gain_table("Trained on snapshots", gains, ABOUT)
    return write_control(folder, [table], {"control": "snapshots", "windows": len(on_map.drives), "gains": gains})


Read = Callable[[Dataset, StoredDrive, int, Rows, slice], Rows]
"""From a dataset, a drive, number and rows of one of its snapshots (as cut, and where) to rows with their ground."""


def own_drives(dataset: Dataset, read: Read) -> Dataset:
    """Every window with a snapshot as a drive of its own.

    Args:
        read: gives its rows their ground.
    """
    return replace(dataset, drives=tuple(_own_drives(dataset, read)), min_hindsight=0.0)


def _own_drives(dataset: Dataset, read: Read) -> Iterator[StoredDrive]:
    for number, drive in enumerate(dataset.drives):
        starts = _starts(dataset, number)
        for snapshot, row in enumerate(drive.snapshots.row if drive.snapshots is not None else ()):
            if int(row) in starts:
                window = slice(int(row) - HISTORY_STEPS, int(row) + HORIZON_STEPS + 1)
                rows = read(dataset, drive, snapshot, drive.rows.cut(window), window)
                yield StoredDrive(f"{drive.name}@{row}", rows, drive.part[window], ())


def _starts(dataset: Dataset, number: int) -> set[int]:
    """Rows at which windows of a drive start that train or validate."""
    part = PARTS[int(dataset.drives[number].part.max())]
    windows = Windows(replace(dataset, drives=(dataset.drives[number],)), part)
    return set(windows.row_in_drive(np.arange(len(windows))).tolist())


def read_on_snapshot(dataset: Dataset, drive: StoredDrive, snapshot: int, rows: Rows, window: slice) -> Rows:
    """Features and normals of a window's snapshot at the recorded places of its wheels; one feature set."""
    assert drive.snapshots is not None
    return with_ground_truth(rows, drive.snapshots.load(snapshot), dataset.rig).rows


def read_as_stored(dataset: Dataset, drive: StoredDrive, snapshot: int, rows: Rows, window: slice) -> Rows:
    """The usual features and normals, of all sets; only the cells that the window touches."""
    cells = drive.rows.cells
    assert cells is not None
    index = cells.index[window]
    used, place = np.unique(index[index >= 0], return_inverse=True)
    own = np.full_like(index, -1)
    own[index >= 0] = place
    kept = {name: getattr(cells, name)[:, used] for name in ("features", "valid", "distance", "elevation")}
    return replace(rows, cells=Cells(own, **kept))
