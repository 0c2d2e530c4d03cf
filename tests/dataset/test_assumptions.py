"""Assumptions behind a dataset in extraction, training, evaluation and report."""

import json
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from cli.command import run
from factories import circle_rows, small_rig, stored_dataset
from feature_datasets import dataset_with_features
from offpiste.dataset.assumptions import assumptions_block, assumptions_of
from offpiste.dataset.log_findings import LogFinding
from offpiste.logs.clock_drift import ALIGNED

JUMPS = LogFinding("warning", "position", "jumps", "3 times, by up to 1.20 m between two samples", "cut the log there")
NOTE = f"{ALIGNED} /wheels: 0.60 s late (5 to 95 %: 0.58 to 0.62 s); aligned"


@pytest.fixture
def dataset(tmp_path):
    """A dataset with a guessed vehicle, an aligned clock and a finding."""
    rig = small_rig()
    guessed = structs.replace(rig, vehicle=structs.replace(rig.vehicle, source="GUESSED: a small car"))
    rows = {"drive": circle_rows(3000)}
    return stored_dataset(
        tmp_path / "d.zarr", rows, "blocks:0.6,0.2,0.2", rig=guessed, notes=(NOTE,), findings=(JUMPS,)
    )


def test_each_assumption_of_a_dataset_is_named(dataset, tmp_path):
    said = "\n".join(assumptions_of(dataset))
    for words in ("guessed vehicle: 800 kg", "0.60 s late", "in hindsight", "slope of the path driven later", "jumps"):
        assert words in said
    channels = {**dataset.rig.channels, "steer_angle": dataset.rig.channels["steer"]}
    measured = replace(dataset, rig=structs.replace(dataset.rig, channels=channels))
    assert "measured angle instead of the command" in "\n".join(assumptions_of(measured))
    visual = replace(dataset_with_features(tmp_path / "features.zarr"), pca="abc")
    assert not any("slope" in each or "true ground" in each for each in assumptions_of(visual))
    assert "none known" in assumptions_block(())


def test_they_travel_through_training_and_evaluation_into_the_report(dataset, tmp_path, capsys):
    words = {"--model": "parametric", "--out": tmp_path / "run", "--bicycle-epochs": 1, "--actuator-epochs": 1}
    for command in (
        ["train", dataset.path, *(word for pair in words.items() for word in pair), "--stride", 50],
        ["evaluate", tmp_path / "run", "--dataset", dataset.path, "--out", tmp_path / "report"],
    ):
        code, shown = run(*command), capsys.readouterr()
        assert code == 0, shown.err
        assert "guessed vehicle: 800 kg" in " ".join((shown.out + shown.err).split())
    metrics = json.loads((tmp_path / "report" / "metrics.json").read_text())
    assert any("0.60 s late" in each for each in metrics["assumptions"])
    report = (tmp_path / "report" / "report.html").read_text()
    assert "guessed vehicle" in report
    assert "as a planner does" not in report
    assert json.loads((tmp_path / "run" / "model.json").read_text())["assumptions"] == metrics["assumptions"]
    assert np.isfinite(metrics["results"][0]["distance_error_m"]["mean"])
