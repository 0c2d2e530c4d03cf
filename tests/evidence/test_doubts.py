"""What a report says against itself: guesses, findings, few windows; and a command line without private paths."""

from dataclasses import replace
from pathlib import Path

from feature_datasets import dataset_with_features
from offpiste.dataset.log_findings import LogFinding
from offpiste.evidence.doubts import doubts, guessed, public_command, vehicle_facts

DRAFT = """\
# A first rig for drive, guessed by `offpiste inspect`. Every line is a guess: read it, fix it
[vehicle]
source = "GUESSED: mass and wheel positions are a small car's"
mass = 1500.0
[channels.steer]  # GUESSED by its name
fields = ["steer"]
[channels.throttle]  # checked
[clock]  # GUESSED
"""


def test_guesses_of_a_first_rig_are_named_until_the_mark_is_removed() -> None:
    assert list(guessed(DRAFT)) == ["mass and wheel positions are a small car's", "[channels.steer]", "[clock]"]
    assert not list(guessed(DRAFT.replace("GUESSED", "measured")))


def test_what_the_console_warns_of_stands_in_the_report(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "dataset.zarr", rows=400)
    found = LogFinding("warning", "steer", "comes late", "0.3 s", "delay = 0.3")
    drives = (replace(dataset.drives[0], findings=(found,)), *dataset.drives[1:])
    lines = list(doubts(replace(dataset, drives=drives), DRAFT))
    assert lines[0].startswith("the rig has guesses that nobody has confirmed: mass and wheel")
    assert lines[1] == "inspect: steer comes late (drive circle-0)"
    assert any("validation part has only" in line for line in lines)
    assert not any("guesses" in line for line in doubts(dataset, ""))
    assert any("the parts of the split drives:dataset.txt are" in line for line in lines)
    assert not any(str(tmp_path) in line for line in lines)


def test_vehicle_and_driving_are_told_apart_from_others(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "dataset.zarr", rows=900)
    facts = vehicle_facts(dataset)
    assert f"{dataset.rig.vehicle.mass:.4g} kg" in facts["vehicle"]
    assert f"wheelbase {dataset.rig.vehicle.wheelbase:.3g} m" in facts["vehicle"]
    metres = sum(drive.rows.distance for drive in dataset.drives)
    assert facts["driving"].startswith(f"{metres / 1000:.2f} km; train")
    assert facts["sensors"] == "cameras: none; LiDARs: none"


def test_a_command_line_keeps_no_folder_and_no_log() -> None:
    words = ["/opt/bin/offpiste", "evidence", "/home/me/a.mcap", "/home/me/b.mcap", "--rig", "/home/me/my.toml"]
    words += ["--split=drives:/home/me/parts.txt", "--weights", "/home/me/dinov2/", "--seeds", "1"]
    line = public_command(words)
    assert line == "offpiste evidence --rig my.toml --split=drives:parts.txt --weights dinov2 --seeds 1 (2 logs)"
    assert "/home" not in line
