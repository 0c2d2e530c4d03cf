"""The demo runs and resumes, and claims no more of its small numbers than they allow."""

import json
from pathlib import Path

import numpy as np
import pytest

from feature_datasets import dataset_with_features
from log_messages import logged
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import RunError
from offpiste.dataset.store import Dataset
from offpiste.demo.whole_path import MAP, DemoSettings, comparison_table, conclusion, gain_of, run_demo
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.intervals import PairedDifference

SMALL = DemoSettings(
    seconds=8.0,
    epochs=1,
    size=80.0,
    resolution=0.5,
    images=4,
    snapshot_seconds=1.0,
    parts=("train", "validation", "test"),
    course_seconds=1.0,
)


def test_the_demo_runs_the_whole_path_and_can_be_repeated(tmp_path: Path) -> None:
    with logged() as messages:
        run_demo(tmp_path, SMALL, processes=1)
    report = tmp_path / "report"
    rows = json.loads((report / "metrics.json").read_text())["results"]
    assert {row["model"] for row in rows} == {"b", "dc", "ctrv", "kinematic"}
    readings = {("recorded", name) for name in FEATURE_SETS} | {("map", None)}
    assert {(row["lookup"], row["feature_set"]) for row in rows if row["model"] == "dc"} == readings
    assert (report / "distance.png").read_bytes().startswith(b"\x89PNG")
    assert f"picture: {report / 'distance.png'}" in messages
    assert any("no real vehicle" in str(line) for line in messages)
    assert any("too few for an interval" in str(line) for line in messages), "one drive of 8 s is too little"

    assert json.loads((tmp_path / "course" / "result.json").read_text())["planner"] == "dc"
    assert messages[-1] == f"picture: {tmp_path / 'course' / 'drive.png'}"

    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")}
    kept |= {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.mcap")}
    with logged() as again:
        run_demo(tmp_path, SMALL, processes=1)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert again[-2:] == messages[-2:]

    with pytest.raises(RunError, match=r"demo\.seconds"):
        run_demo(tmp_path, DemoSettings())


def errors(distance: np.ndarray) -> Errors:
    """Windows 0.5 s apart on one drive, off by these distances after 5 s."""
    values = np.zeros((len(distance), 5, 5))
    values[:, -1, 0] = distance
    return Errors(np.zeros(len(distance), int), 25 * np.arange(len(distance)), values, np.ones(len(distance)))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """36 s to train, 18 s to test."""
    return dataset_with_features(tmp_path_factory.mktemp("demo") / "seen.zarr")


def test_the_gain_is_relative_to_b_on_the_same_windows() -> None:
    halves = np.tile([2.0, 6.0], 60)  # mean 4
    by_reading = {
        "hindsight": {"b": errors(halves), "dc": errors(0.75 * halves)},
        MAP: {"b": errors(halves), "dc": errors(halves)},
    }
    assert gain_of(by_reading["hindsight"]).mean == pytest.approx(-0.25)
    assert gain_of(by_reading["hindsight"]).ci95 == pytest.approx((-0.25, -0.25))
    table = comparison_table(by_reading)
    assert table.names == ("terrain", "b", "dc", "dc against b")
    assert [line[0] for line in table.lines] == ["hindsight", MAP]
    assert table.lines[0][1].startswith("4.00 [")
    assert table.lines[0][3] == "-25.0 % [-25.0, -25.0]"
    assert table.lines[1][3] == "+0.0 % [0.0, 0.0]"
    assert "120 windows" in table.title


@pytest.mark.parametrize(
    ("gain", "text"),
    [
        (
            PairedDifference(-0.2, (-0.3, -0.1)),
            "Here dc is 20 % below b, with 36 s of driving for training and 18 s for",
        ),
        (PairedDifference(-0.2, (-0.5, 0.1)), "No difference between dc and b is shown here"),
        (PairedDifference(0.2, (0.1, 0.3)), "Here dc is 20 % above b: 36 s of driving"),
        (PairedDifference(-0.2, (np.nan, np.nan)), "No conclusion on dc against b here"),
    ],
)
def test_no_more_is_claimed_than_the_interval_allows(dataset: Dataset, gain: PairedDifference, text: str) -> None:
    assert conclusion(gain, dataset).startswith(text)
