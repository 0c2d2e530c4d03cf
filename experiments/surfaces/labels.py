"""Recordings of DART's car on three floors, with a label of the recording in the place of terrain features."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.place import drive_names
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.splits import PARTS, Split
from offpiste.dataset.store import Dataset, add_drive, create, open_dataset
from offpiste.dataset.window_starts import evaluation_starts
from offpiste.errors import LogError
from offpiste.logs.drive import drive_name, read_drive
from offpiste.rig.rig import load_rig

FLOORS = ("tape_and_tiles", "rubbery", "slippery")
_FOLDERS = ("81_circles_tape_and_tiles", "82_free_driving_rubbery_floor", "83_16_april_2025_slippery_floor")
_RIGS = ("dart", "dart", "dart_filtered")
_APART = 50
"""Rows left out beside the validation part of a recording: twice the window over which velocities are estimated."""

Labels = Mapping[str, int]
"""Number of the label of each recording, by its name."""


@dataclass(frozen=True)
class Recording:
    """One table of DART.

    Attributes:
        floor: number in `FLOORS`; day and file format go with it.
    """

    path: Path
    floor: int

    @property
    def name(self) -> str:
        """Name of the drive in a dataset."""
        return drive_name(self.path)


def recordings(folder: Path) -> tuple[Recording, ...]:
    """All tables, by floor and time.

    Raises:
        LogError: a floor has none.
    """
    result = []
    for floor, name in enumerate(_FOLDERS):
        paths = sorted((folder / name).glob("*.csv"))
        if not paths:
            raise LogError("no recordings", where=folder / name, how="give the folder `dart` of the recorded data")
        result += [Recording(path, floor) for path in paths]
    return tuple(result)


def extract_floors(result: Sequence[Recording], out: Path) -> tuple[Dataset, Labels]:
    """Rows of all recordings that have windows, and their floors. What is there already stays.

    The two presets differ in their names only, so one rig serves both.
    """
    split = Split("drives:recordings", "drives", drives=tuple((r.name, "train") for r in result))
    create(out, load_rig("dart"), split, FLOORS)
    for recording in result:
        if recording.name in drive_names(out):
            continue
        drive = read_drive(recording.path, load_rig(_RIGS[recording.floor]))
        rows = labelled(extract_rows(drive), recording.floor)
        if len(evaluation_starts(rows, rows.valid)):
            add_drive(out, recording.name, rows, split, drive.notes)
    dataset = open_dataset(out)
    return dataset, {r.name: r.floor for r in result if r.name in {drive.name for drive in dataset.drives}}


def labelled(rows: Rows, label: int, count: int = len(FLOORS)) -> Rows:
    """The rows of a recording on one cell that holds its label as `count` features, of which one is 1."""
    cells = Cells(
        index=np.zeros((len(rows.time), 4), np.int32),
        features=np.eye(count, dtype=np.float16)[None, label : label + 1],
        valid=np.ones((1, 1), bool),
        distance=np.full((1, 1), np.nan, np.float32),
        elevation=np.full((1, 1), np.nan, np.float32),
    )
    return replace(rows, cells=cells)


def relabelled(dataset: Dataset, labels: Labels) -> Dataset:
    """The same recordings under other labels."""
    return replace(dataset, drives=tuple(replace(d, rows=labelled(d.rows, labels[d.name])) for d in dataset.drives))


def halves(floors: Labels) -> Mapping[str, int]:
    """Which half each recording is tested in: every other one of each floor, so that both halves have all floors."""
    result, count = {}, dict.fromkeys(floors.values(), 0)
    for name, floor in floors.items():
        result[name] = count[floor] % 2
        count[floor] += 1
    return result


def held_out(dataset: Dataset, tested: Sequence[str]) -> Dataset:
    """Whole recordings are the test part; of each other one, the fifth in its middle validates and the rest trains."""
    drives = []
    for drive in dataset.drives:
        part = np.full(len(drive.rows.time), PARTS.index("test"), np.int8)
        if drive.name not in tested:
            first, end = int(0.4 * len(part)), int(0.6 * len(part))
            part[:] = PARTS.index("train")
            part[first - _APART : end + _APART] = -1
            part[first:end] = PARTS.index("validation")
        drives.append(replace(drive, part=part))
    return replace(dataset, drives=tuple(drives))


def shuffled(floors: Labels, half: Mapping[str, int], count: int, seed: int) -> list[Labels]:
    """Different false labellings, drawn without the true one.

    Labels change places within a half only: each occurs as often as the floors do, in training and in test.
    """
    rng = np.random.default_rng(seed)
    result: list[Labels] = []
    while len(result) < count:
        drawn = dict(floors)
        for number in (0, 1):
            names = [name for name in floors if half[name] == number]
            drawn |= dict(zip(names, rng.permutation([floors[name] for name in names]).tolist(), strict=True))
        if drawn != dict(floors) and drawn not in result:
            result.append(drawn)
    return result


def formats(floors: Labels) -> Labels:
    """The file format of each recording: the slippery floor's or the others'."""
    return {name: int(_RIGS[floor] == "dart_filtered") for name, floor in floors.items()}
