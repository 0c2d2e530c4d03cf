"""`offpiste view` on a simulated drive and on the real one."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli.command import refusal, run
from log_messages import logged
from offpiste.logs.log import open_log
from offpiste.perception.feature_extractor import load_feature_extractor
from offpiste.rig.rig import load_rig
from offpiste.visualization import view_log as module
from offpiste.visualization.view_log import view_log

PICTURES = {"sensors.png", "overlay.png", "features.png", "map.png", "map-near.png"}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_pictures_and_a_recording_that_can_be_read_back(drive: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    out = tmp_path / "out"
    options = ("--rig", "proving_ground", "--pca", drive / "pca.safetensors", "--out", out, "--seconds", "0.5:1.7")
    assert run("view", drive / "drive.mcap", *options) == 0
    assert names(out) == PICTURES | {"drive.rrd"}
    for name in PICTURES:
        assert min(cv2.imread(str(out / name)).shape[:2]) > 200, name
    found = read_back(out / "drive.rrd")
    assert {"/world/scan", "/world/wheels", "/world/vehicle", "/features/camera_front"} <= found
    assert {"/world/cameras/camera_front", "/world/cameras/camera_front/image"} <= found
    assert any(path.startswith("/world/map/ground/") for path in found)
    assert any(path.startswith("/world/map/slope/") for path in found)


def read_back(path: Path) -> set[str]:
    """Entities of a recording."""
    rerun = Path(sys.executable).parent / "rerun"
    done = subprocess.run([rerun, "rrd", "verify", path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    stats = subprocess.run([rerun, "rrd", "stats", path], capture_output=True, text=True, check=True).stdout
    return {line.split(":")[0] for line in stats.splitlines() if line.startswith("/")}


def test_without_pca_and_without_rerun_there_are_pictures_and_a_line(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "is_installed", lambda name: False)
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    for name in ("map.png", "sensors.png"):
        (out / name).write_text("an old one")
    options = ("--rig", "proving_ground", "--out", out, "--seconds", ":0.6")
    assert run("view", drive / "drive.mcap", *options) == 0
    assert names(out) == PICTURES - {"features.png"} | {"mine.txt"}
    assert (out / "mine.txt").read_text() == "mine"
    assert cv2.imread(str(out / "map.png")) is not None
    said = capsys.readouterr().out
    assert "pip install '.[view]'" in said
    assert "0% of it with features" in said


def test_an_interrupted_view_leaves_no_recording(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun")
    kept = module.Recorder.add

    def interrupted(self, moment, pose):  # type: ignore[no-untyped-def]
        kept(self, moment, pose)
        raise KeyboardInterrupt

    monkeypatch.setattr(module.Recorder, "add", interrupted)
    for name in ("drive.rrd", "sensors.png"):
        (tmp_path / name).write_text("the one before")
    assert run("view", drive / "drive.mcap", "--rig", "proving_ground", "--out", tmp_path) == 1
    assert names(tmp_path) == {"drive.rrd", "sensors.png", ".offpiste-view"}, "and the mark of an unfinished view"
    assert (tmp_path / "drive.rrd").read_text() == "the one before"
    assert "interrupted" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nothing",), "no such file"),
        (("drive.mcap",), "give --rig"),
        (("drive.mcap", "--rig", "tartandrive2"), "has neither cameras nor LiDARs"),
        (("drive.mcap", "--rig", "proving_ground", "--seconds", "70:"), "its poses cover 2."),
        (("pca.safetensors", "--rig", "proving_ground"), "neither a log of a known format nor a dataset"),
        (("drive.mcap", "--rig", "proving_ground", "--out", "pca.safetensors"), "is a file"),
    ],
)
def test_what_cannot_be_viewed_ends_in_one_line(
    arguments: tuple[str, ...],
    said: str,
    drive: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(drive)
    assert said in refusal(capsys, "view", *arguments)


def test_the_real_drive(data_folder: Path, tmp_path: Path, drive: Path) -> None:
    """A second of KITTI."""
    log = open_log(data_folder / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0013_sync")
    extractor = load_feature_extractor(drive / "pca.safetensors")
    with logged() as said:
        view_log(log, load_rig("kitti"), tmp_path, extractor=extractor, stretch=(4.0, 4.8), rrd=False)
    assert names(tmp_path) == PICTURES
    picture = cv2.imread(str(tmp_path / "features.png"))
    # Right of the image its features: patches of one colour each, not black.
    assert np.median(picture[:, picture.shape[1] // 2 :].max(axis=2)) > 60
    assert "with features" in str(said[-1])
