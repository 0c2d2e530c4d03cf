"""Labels in the place of features: recordings held out whole, false labels as frequent as true ones, honest tables."""

from pathlib import Path

import numpy as np
import pytest

from experiments.surfaces.labels import (
    FLOORS,
    extract_floors,
    formats,
    halves,
    held_out,
    labelled,
    recordings,
    relabelled,
    shuffled,
)
from experiments.surfaces.tables import tables
from experiments.surfaces.trials import Trial, train_once
from factories import circle_rows, small_rig
from offpiste.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.splits import PARTS, Split
from offpiste.dataset.store import Dataset, add_drive, create, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.errors import LogError
from offpiste.evaluation.errors import Errors
from offpiste.training.config import TrainConfig

NAMES = [f"recording{number}" for number in range(10)]
TRUE = dict(zip(NAMES, (0, 0, 1, 1, 1, 2, 2, 2, 2, 2), strict=True))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    path = tmp_path_factory.mktemp("surfaces") / "dataset.zarr"
    split = Split("drives:recordings", "drives", drives=tuple((name, "train") for name in NAMES[:4]))
    create(path, small_rig(), split, FLOORS)
    for number, name in enumerate(NAMES[:4]):
        add_drive(path, name, labelled(circle_rows(2400, seed=number), TRUE[name]), split, ())
    return open_dataset(path)


def test_a_window_reads_the_label_of_its_recording_at_every_wheel(dataset: Dataset) -> None:
    windows = Windows(held_out(dataset, NAMES[2:4]), "test")
    index = np.flatnonzero(windows.drive == 3)[:2]
    ground = windows.gather(index).ground
    for under in (ground.past, ground.ahead):
        read = ground.features[under]
        assert (read == read.new_tensor([0.0, 1.0, 0.0])).all()
        assert ground.valid[under].all()


def test_labels_can_be_exchanged_without_touching_anything_else(dataset: Dataset) -> None:
    other = relabelled(dataset, dict.fromkeys(NAMES, 2))
    for before, after in zip(dataset.drives, other.drives, strict=True):
        assert after.rows.cells.features.tolist() == [[[0.0, 0.0, 1.0]]]
        assert after.rows.state is before.rows.state


def test_tested_recordings_are_held_out_whole_and_no_window_spans_two_parts(dataset: Dataset) -> None:
    split = held_out(dataset, [NAMES[1]])
    for drive in split.drives:
        assert (drive.part == PARTS.index("test")).all() == (drive.name == NAMES[1])
    rows = {part: [] for part in ("train", "validation")}
    for part, found in rows.items():
        windows = Windows(split, part)
        for drive, row in zip(windows.drive, windows.row_in_drive(np.arange(len(windows))), strict=True):
            found.append((drive, row - HISTORY_STEPS, row + HORIZON_STEPS))
    latest = {(d, last) for d, _, last in rows["train"] if last < 960}
    earliest = {(d, first) for d, first, _ in rows["validation"]}
    assert max(last for _, last in latest) + 50 <= min(first for _, first in earliest)


def test_halves_have_every_floor_and_share_no_recording() -> None:
    half = halves(TRUE)
    for number in (0, 1):
        assert {TRUE[name] for name in NAMES if half[name] == number} == {0, 1, 2}
    assert [half[name] for name in NAMES] == [0, 1, 0, 1, 0, 0, 1, 0, 1, 0]


def test_false_labels_are_false_different_and_as_frequent_in_each_half() -> None:
    half = halves(TRUE)
    drawn = shuffled(TRUE, half, 8, seed=3)
    assert len({tuple(labels[name] for name in NAMES) for labels in drawn}) == 8
    for labels in drawn:
        assert labels != TRUE
        for number in (0, 1):
            mine = [name for name in NAMES if half[name] == number]
            assert sorted(labels[name] for name in mine) == sorted(TRUE[name] for name in mine)
    assert drawn == shuffled(TRUE, half, 8, seed=3)
    assert drawn != shuffled(TRUE, half, 8, seed=4)


def test_the_format_tells_the_slippery_floor_only() -> None:
    assert list(formats(TRUE).values()) == [0] * 5 + [1] * 5


def test_a_trained_trial_is_not_trained_again_and_is_evaluated_on_the_held_out_half(
    dataset: Dataset, tmp_path: Path
) -> None:
    config = TrainConfig(model="df", epochs=1, bicycle_epochs=1, stride=100)
    trial = Trial(dataset.path, tmp_path / "floor-df-0", "floor", TRUE, (NAMES[1], NAMES[3]), config)
    train_once(trial, lambda share: None)
    written = (trial.folder / "model.json").stat().st_mtime_ns
    train_once(trial, lambda share: None)
    assert (trial.folder / "model.json").stat().st_mtime_ns == written
    errors, wrong = trial.errors(), trial.errors(dict.fromkeys(NAMES, 2))
    assert set(errors.drive) == {1, 3}
    assert np.array_equal(errors.key, wrong.key)
    assert not np.array_equal(errors.values, wrong.values)


def errors_of(values: dict[int, float]) -> Errors:
    """Constant errors by recording, 40 s each."""
    drive = np.repeat(list(values), 400)
    row = np.tile(5 * np.arange(400), len(values))
    error = np.repeat(list(values.values()), 400)
    return Errors(drive, row, np.tile(error[:, None, None], (1, 5, 5)), error)


def test_tables_compare_runs_of_the_same_seed_and_name_every_recording() -> None:
    results = {
        ("none", "b", 0): errors_of({0: 1.0, 1: 2.0, 2: 3.0}),
        ("none", "b", 1): errors_of({0: 2.0, 1: 4.0, 2: 6.0}),
        ("shuffled0", "df", 1): errors_of({0: 2.0, 1: 4.0, 2: 6.0}),
        **{
            (label, "df", seed): errors_of({0: scale, 1: 2.0 * scale, 2: 3.0 * scale})
            for label in ("floor", "format", "exchanged")
            for seed, scale in ((0, 0.5), (1, 1.0))
        },
    }
    said = tables(results, NAMES[:3], dict(zip(NAMES[:3], range(3), strict=True)), FLOORS)
    assert "| `df` | the floor | 1.500 | -50.0% [-50, -50]" in said
    assert "`df` minus `b` of the same seed: -50.0%, -50.0%; false: +0.0%." in said
    assert f"| {NAMES[2]} | slippery | 400 | 4.500 | 2.250 |" in said


def test_recordings_of_dart(data_folder: Path, tmp_path: Path) -> None:
    found = recordings(data_folder / "dart")
    assert [sum(r.floor == floor for r in found) for floor in range(3)] == [2, 6, 5]
    some = [found[0], found[5], found[9]]  # the middle one is too slow for any window
    dataset, floors = extract_floors(some, tmp_path / "dataset.zarr")
    assert list(floors.values()) == [0, 2]
    assert [drive.rows.cells.features.argmax() for drive in dataset.drives] == [
        floors[drive.name] for drive in dataset.drives
    ]
    assert dataset.rig.name == "dart"


def test_no_recordings(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no recordings"):
        recordings(tmp_path)
