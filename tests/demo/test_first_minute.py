"""The demo of shipped models: files, resumption, sentences, a drive that is too short."""

import json
import logging
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from offpiste.core.errors import OffpisteError
from offpiste.core.shipped import run_folder
from offpiste.demo.comparison import Predictions, closing_words
from offpiste.demo.first_minute import FIRST_WORLD, MODELS, FirstMinuteSettings, run_first_minute, shipped
from offpiste.evaluation.intervals import PairedDifference
from offpiste.evaluation.model_card import CourseFigures, load_card

SMALL = FirstMinuteSettings(
    seconds=8.0, snapshot_seconds=1.0, course_seconds=1.0, course_speed=5.0, course_length=60.0, size=120.0,
    resolution=0.5,
)  # fmt: skip


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo")
    run_first_minute(out, SMALL, processes=1)
    return out


def test_it_leaves_a_picture_the_logs_and_the_results(shown: Path) -> None:
    assert cv2.imread(str(shown / "demo.png")).shape[1] > 1000
    assert (shown / "logs" / "drive.mcap").stat().st_size > 100_000
    outcome = json.loads((shown / "demo.json").read_text("utf-8"))
    assert outcome["moments"] >= 1
    assert all(0 < outcome["error_m"][model] < 30 for model in MODELS)
    for model in MODELS:
        result = json.loads((shown / model / "result.json").read_text("utf-8"))
        assert result["planner"] == model
        assert (result["world"], result["seed"]) == ("mojave", FIRST_WORLD)


def test_again_nothing_is_driven_anew_and_it_says_the_same(shown: Path, caplog: pytest.LogCaptureFixture) -> None:
    before = {file: file.stat().st_mtime_ns for file in shown.rglob("*.mcap")}
    with caplog.at_level(logging.INFO, "offpiste"):
        run_first_minute(shown, SMALL, processes=1)
    assert {file: file.stat().st_mtime_ns for file in shown.rglob("*.mcap")} == before
    text = "\n".join(caplog.messages)
    for said in (
        "error of the predicted position after 5 s [m]",
        "Here, predictions of the visual model",
        "Typically ",
        str(shown / "demo.png"),
        "Next:",
    ):
        assert said in text
    with pytest.raises(OffpisteError, match="other settings"):
        run_first_minute(shown, replace(SMALL, seed=1))


def test_a_drive_without_a_moment_to_predict_from_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OffpisteError, match="too short to predict 5 s; choose another world with --seed"):
        run_first_minute(tmp_path, replace(SMALL, seconds=3.0), processes=1)


def predictions(b: float, dc: float) -> Predictions:
    """Of one moment, off by so much after 5 s [m]."""
    recorded = np.zeros((1, 250, 2))
    paths = {"b": recorded + np.array([b, 0.0]), "dc": recorded + np.array([0.0, dc])}
    return Predictions(np.array([0]), recorded, paths, {"dc": run_folder(shipped("dc"))})


def test_the_words_say_who_was_nearer_here_what_is_usual_and_how_it_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    card = load_card(run_folder(shipped("dc")))
    driving = CourseFigures(20, PairedDifference(-0.2, (-0.5, 0.3)), "abc", "2026-11-23")
    monkeypatch.setattr("offpiste.demo.comparison.load_card", lambda _: msgspec.structs.replace(card, driving=driving))
    here, usual, drives = closing_words(predictions(4.0, 3.0))
    assert drives.startswith("Driving with the visual model: On 20 courses in unseen worlds, its driving cost differs")
    assert "predictions of the visual model end 25 % closer" in here
    assert "error after 5 s 3.00 m instead of 4.00 m; it is closer in 1 of 1" in here
    gain = card.over_seeds.against_b
    assert usual.startswith(
        f"Typically {-100 * gain.mean:.0f} % [{-100 * gain.ci95[1]:.0f}, {-100 * gain.ci95[0]:.0f}]"
    )
    assert "50 % farther from" in next(iter(closing_words(predictions(2.0, 3.0))))
