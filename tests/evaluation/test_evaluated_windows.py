"""Speed, distance, bands and overlap with training of evaluated windows."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from factories import circle_rows, small_rig, stored_dataset
from offpiste.core.errors import OffpisteError, RunError
from offpiste.core.limits import LARGEST_TEXT
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import PARTS, Split
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluate import evaluate_models
from offpiste.evaluation.evaluate_runs import _other_report, evaluate_runs
from offpiste.evaluation.evaluated_windows import (
    BANDS,
    REVERSE,
    EvaluatedWindows,
    in_reverse,
    members,
    share_driven_in_training,
)
from offpiste.evaluation.intervals import Sampling
from offpiste.evaluation.report import band_table
from offpiste.rig.channels import ChannelSource
from offpiste.training.config import TrainConfig, refuse_impossible

SPLIT = Split("all", "drives", drives=(("line", "test"),))


def line(parts: dict[str, slice]) -> StoredDrive:
    """5 m/s along x: row r is at 0.1 r metres."""
    part = np.full(1000, -1, dtype=np.int8)
    for name, where in parts.items():
        part[where] = PARTS.index(name)
    return StoredDrive("line", replace(circle_rows(1000, yaw_rate=1e-6), origin=np.zeros(2)), part, ())


def made_of(*drives: StoredDrive) -> Dataset:
    return Dataset(Path("nowhere"), small_rig(), SPLIT, drives)


def test_a_path_driven_before_was_driven_in_training_wherever_the_drives_origins_are() -> None:
    trained = line({"train": slice(0, 500)})
    again = replace(line({"test": slice(0, 1000)}), name="again")
    # Test runs from x = 10 to 109.9 m, 4 m beside training, which ends at 49.9 m: near until 49.9 + 3 m.
    for shift, share in (((10.0, 4.0), 0.43), ((10.0, 6.0), 0.0)):
        moved = replace(again, rows=replace(again.rows, origin=np.array(shift)))
        assert share_driven_in_training(made_of(trained, moved)) == pytest.approx(share, abs=0.005)
    assert share_driven_in_training(made_of(line({"train": slice(0, 400), "test": slice(600, 1000)}))) == 0.0
    assert share_driven_in_training(made_of(again)) == 0.0
    assert np.isnan(share_driven_in_training(made_of(trained)))


def test_speed_and_distance_of_windows() -> None:
    drive = line({"test": slice(0, 1000)})
    drive.rows.state[:100, 3] = np.nan
    drive.rows.state[500:, 3] = 10.0
    drive.rows.state_causal[300, 3:5] = (3.0, 4.0)
    windows = EvaluatedWindows(made_of(drive), np.zeros(3, dtype=int), np.array([100, 300, 400]))
    assert windows.driven_distance[[0, 2]] == pytest.approx([25.0, 0.02 * (100 * 5 + 150 * 10)])
    assert windows.start_speed[1] == pytest.approx(5.0)
    assert windows.at_start("control").shape == (3, 3)


def test_the_step_between_windows_is_what_it_is_where_only_some_are_evaluated() -> None:
    # Windows with a snapshot: 20 to 30 rows apart, and none between drives.
    drive, row = np.repeat([0, 1], 4), np.array([5, 25, 45, 75, 1000, 1020, 1045, 1065])
    empty = made_of(line({}))
    assert EvaluatedWindows(empty, drive, row).usual_step(5) == 20
    assert EvaluatedWindows(empty, drive[[0, 4]], row[[0, 4]]).usual_step(5) == 5


SPEEDS = {"standing": 1e-3, "crawling": 0.8, "slow": 2.0, "usual": 5.0, "fast": 12.0, "backwards": -2.0}


def driven(speed: float) -> Rows:
    """A circle at a speed, exactly known."""
    rows = circle_rows(1000, speed=abs(speed), yaw_rate=0.2)
    state = rows.state.copy()
    state[:, 3] = speed
    return replace(rows, state=state, state_causal=state.copy())


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    split = Split("all", "drives", drives=tuple((name, "test") for name in SPEEDS))
    drives = {name: driven(speed) for name, speed in SPEEDS.items()}
    return stored_dataset(tmp_path_factory.mktemp("bands") / "data.zarr", drives, split)


def of(dataset: Dataset) -> EvaluatedWindows:
    windows = Windows(dataset, "test")
    index = windows.every(50)
    return EvaluatedWindows(dataset, windows.drive[index], windows.row_in_drive(index))


def test_every_window_is_in_one_band(dataset: Dataset) -> None:
    windows = of(dataset.starting_above(0.0))
    names = [drive.name for drive in dataset.drives]
    found = {band: {names[d] for d in windows.drive[mine]} for band, mine in members(windows).items()}
    slow, crawl, usual, fast = (band.name for band in BANDS)
    wanted = {slow: {"standing", "crawling"}, crawl: {"slow"}, usual: {"usual"}, fast: {"fast"}, REVERSE: {"backwards"}}
    assert found == wanted
    assert np.sum(list(members(windows).values()), axis=0).tolist() == [1] * len(windows.row)


def test_a_gear_says_what_is_in_reverse(dataset: Dataset) -> None:
    """From a standstill the velocity does not; in neutral it does."""
    gears = {"standing": -1.0, "backwards": 0.0, "slow": 0.0}

    def geared(drive: StoredDrive) -> StoredDrive:
        gear = np.full((len(drive.rows.time), 1), gears.get(drive.name, 1.0), np.float32)
        columns = {name: np.hstack((getattr(drive.rows, name), gear)) for name in ("control", "control_causal")}
        return replace(drive, rows=replace(drive.rows, **columns))

    channels = {**dataset.rig.channels, "gear": ChannelSource(fields=("gear",))}
    rig = msgspec.structs.replace(dataset.rig, channels=channels)
    windows = of(replace(dataset, rig=rig, drives=tuple(map(geared, dataset.drives))).starting_above(0.0))
    assert {dataset.drives[d].name for d in windows.drive[in_reverse(windows)]} == {"standing", "backwards"}


def test_bands_are_in_the_metrics_and_the_report(dataset: Dataset) -> None:
    some = dataset.starting_above(0.0)
    evaluation = evaluate_models([], some, scale=torch.ones(5), stride=100, sampling=Sampling(block_seconds=2.0))
    bands = evaluation.metrics.bands
    assert {row.band for row in bands} == {*(band.name for band in BANDS), REVERSE}
    assert {row.model for row in bands} == {"ctrv", "kinematic"}
    one = {(row.model, row.start, row.horizon_s): 0.0 for row in bands}
    for row in bands:
        one[row.model, row.start, row.horizon_s] += row.n * row.distance_error_m.mean
    for row in evaluation.metrics.results:
        assert one[row.model, row.start, row.horizon_s] == pytest.approx(row.n * row.distance_error_m.mean)
    text = band_table(bands).text()
    assert "reverse" in text
    assert "0 to 1.5 m/s" in text


@pytest.mark.parametrize("wrong", [-1.0, float("nan")])
def test_impossible_speeds_are_refused(wrong: float, dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"invalid --min-speed .*; give a speed of 0 or more"):
        refuse_impossible(TrainConfig(min_speed=wrong))
    with pytest.raises(OffpisteError, match="invalid --min-speed"):
        evaluate_runs([tmp_path / "run"], dataset.path, tmp_path / "out", min_speed=wrong)


def test_a_report_too_large_to_read_is_not_described(tmp_path: Path) -> None:
    with (tmp_path / "metrics.json").open("wb") as file:
        file.truncate(LARGEST_TEXT + 1)
    assert _other_report(tmp_path, SimpleNamespace()) is None
