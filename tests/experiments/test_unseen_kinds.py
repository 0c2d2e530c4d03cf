"""Kinds of ground that are held out of training: which rows and windows that leaves, and how they are evaluated."""

from pathlib import Path

import numpy as np
import pytest

from experiments.unseen_kinds import chosen_kinds, nearest_kinds, rows_of, without_kind
from feature_datasets import dataset_with_features, with_snapshots
from offpiste.core.conventions import HORIZON_STEPS
from offpiste.core.errors import DatasetError
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.world.ground import property_table
from offpiste.training.config import TrainConfig
from offpiste.training.run import load_run
from offpiste.training.train import train
from offpiste.uncertainty.calibration import kept_or_fitted
from offpiste.uncertainty.fit import SpreadSettings

GRAVEL, MUD = GROUND_KINDS.index("gravel"), GROUND_KINDS.index("mud")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("kinds")
    return with_snapshots(dataset_with_features(folder / "dataset.zarr"), folder / "snapshots", [200])


def test_ground_of_a_kind_at_any_wetness_and_a_little_mixed_is_of_that_kind() -> None:
    dry, wet = property_table()
    numbers = np.arange(len(GROUND_KINDS))
    for wetness in (0.0, 0.4, 1.0):
        pure = (1 - wetness) * dry + wetness * wet
        np.testing.assert_array_equal(nearest_kinds(pure), numbers)
    mixed = 0.95 * dry + 0.05 * np.roll(wet, -1, axis=0)
    np.testing.assert_array_equal(nearest_kinds(mixed), numbers)


def test_windows_that_touch_the_kind_train_nothing_and_test_everything(dataset: Dataset) -> None:
    kinds = [np.full((len(drive.rows.time), 4), MUD) for drive in dataset.drives]
    touched = [np.random.default_rng(1).integers(len(on), size=3) for on in kinds]
    for on, rows in zip(kinds, touched, strict=True):
        on[rows, 1] = GRAVEL
    without = without_kind(dataset, kinds, GRAVEL)
    for part in PARTS:
        before, after = Windows(dataset, part), Windows(without, part)
        kept = set(zip(after.drive.tolist(), after.rows.tolist(), strict=True))
        for number, row in zip(before.drive, before.rows, strict=True):
            start = row - before._offset[number]
            own = range(start - 10, start + HORIZON_STEPS + 1)
            clear = part == "test" or not any(r in own for r in touched[number])
            assert ((number, row) in kept) == clear
    assert len(Windows(without, "train")) < len(Windows(dataset, "train"))


def test_kinds_with_too_few_windows_and_unknown_ones_are_refused() -> None:
    mostly = np.zeros((60, len(GROUND_KINDS)), bool)
    mostly[:, MUD] = True
    mostly[:20, GRAVEL] = True
    assert chosen_kinds((), mostly) == chosen_kinds(("mud", "gravel"), mostly) == [MUD]
    with pytest.raises(DatasetError, match="fewer than 50 test windows"):
        chosen_kinds(("gravel",), mostly)
    with pytest.raises(DatasetError, match="no kind of ground is called 'snow'"):
        chosen_kinds(("snow",), mostly)


def test_a_run_without_the_kind_is_evaluated_where_it_is(dataset: Dataset, tmp_path: Path) -> None:
    kinds = [np.full((len(drive.rows.time), 4), MUD) for drive in dataset.drives]
    for on in kinds:
        on[: len(on) // 8] = GRAVEL
    without = without_kind(dataset, kinds, GRAVEL)
    config = TrainConfig("dc", epochs=1, bicycle_epochs=1, actuator_epochs=1, batch=32, stride=80, learning_rate=1e-3)
    train(without, config, tmp_path / "dc-0")
    run, windows = load_run(tmp_path / "dc-0"), Windows(dataset, "test")
    spread = kept_or_fitted(run, without, SpreadSettings(windows=40, steps=3, batch=16))
    index = windows.evaluation_indices(5)
    rows = rows_of("gravel held out", run, spread, windows, {"on it": index, "never on it": index[:0]})
    assert [(row.windows, row.horizon) for row in rows] == [("on it", h) for h in (1, 3, 5)]
    assert all(row.n == len(index) and row.run == "gravel held out" and row.error_m > 0 for row in rows)
