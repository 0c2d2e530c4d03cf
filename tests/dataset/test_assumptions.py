"""Assumptions behind a dataset in extraction, training, evaluation and report."""

import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from factories import circle_rows, small_rig
from feature_datasets import dataset_with_features
from offpiste.cli import main
from offpiste.dataset.assumptions import assumptions_block, assumptions_of
from offpiste.dataset.log_findings import LogFinding
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset, add_drive, create, open_dataset
from offpiste.logs.clock_drift import ALIGNED
from offpiste.rig.rig import Rig

JUMPS = LogFinding("warning", "position", "jumps", "3 times, by up to 1.20 m between two samples", "cut the log there")
NOTE = f"{ALIGNED} /wheels: 0.60 s late (5 to 95 %: 0.58 to 0.62 s); aligned"


def guessed_rig() -> Rig:
    rig = small_rig()
    return msgspec.structs.replace(rig, vehicle=msgspec.structs.replace(rig.vehicle, source="GUESSED: a small car"))


def small_dataset(path: Path, rig: Rig, **drive: object) -> Dataset:
    split = parse_split("blocks:0.6,0.2,0.2")
    create(path, rig, split)
    notes = drive.pop("notes", ())
    add_drive(path, "drive", circle_rows(3000, seed=0), split, notes, **drive)
    return open_dataset(path)


def test_each_assumption_of_a_dataset_is_named(tmp_path):
    said = assumptions_of(small_dataset(tmp_path / "d.zarr", guessed_rig(), notes=(NOTE,), findings=(JUMPS,)))
    wanted = (
        "guessed vehicle: 800 kg",
        "0.60 s late",
        "in hindsight",
        "slope of the path driven later",
        "jumps",
    )
    for words in wanted:
        assert any(words in each for each in said), words


def test_a_measured_steering_in_place_of_the_command_is_named(tmp_path):
    rig = small_rig()
    channels = {**rig.channels, "steer_angle": rig.channels["steer"]}
    dataset = replace(small_dataset(tmp_path / "d.zarr", rig), rig=msgspec.structs.replace(rig, channels=channels))
    assert any("measured angle instead of the command" in each for each in assumptions_of(dataset))


def test_a_dataset_with_visual_features_reads_no_slope_of_the_path(tmp_path):
    dataset = replace(dataset_with_features(tmp_path / "d.zarr"), pca="abc")
    assert not any("slope" in each or "true ground" in each for each in assumptions_of(dataset))
    assert "none known" in assumptions_block(())


def test_they_travel_through_training_and_evaluation_into_the_report(tmp_path, capsys):
    path = tmp_path / "d.zarr"
    small_dataset(path, guessed_rig(), notes=(NOTE,), findings=(JUMPS,))
    words = {"--model": "parametric", "--out": tmp_path / "run", "--bicycle-epochs": 1, "--actuator-epochs": 1}
    commands = (
        ["train", path, *(str(word) for pair in words.items() for word in pair), "--stride", "50"],
        ["evaluate", tmp_path / "run", "--dataset", path, "--out", tmp_path / "report"],
    )
    for command in commands:
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in command])
        shown = capsys.readouterr()
        assert ended.value.code == 0, shown.err
        assert "guessed vehicle: 800 kg" in " ".join((shown.out + shown.err).split())
    metrics = json.loads((tmp_path / "report" / "metrics.json").read_text())
    assert any("0.60 s late" in each for each in metrics["assumptions"])
    report = (tmp_path / "report" / "report.html").read_text()
    assert "guessed vehicle" in report
    assert "as a planner does" not in report
    assert json.loads((tmp_path / "run" / "model.json").read_text())["assumptions"] == metrics["assumptions"]
    assert np.isfinite(metrics["results"][0]["distance_error_m"]["mean"])
