"""Rerun recording of a driven course, read back by Rerun's own tool."""

import subprocess
import sys
from pathlib import Path

import pytest

from offpiste.closed_loop import recording
from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
from offpiste.runtime.planner import Planner
from offpiste.simulation.world.world import WorldSettings
from runtime.stream import parametric, settings

WORLD = WorldSettings("dunes", seed=3, size=120.0, resolution=0.5)
SETTINGS = CourseDriveSettings(
    WORLD, seconds=1.0, course=CourseSettings(speed=5.0, length=60.0, candidates=2), runtime=settings(), keep_log=False
)
PLANNER = Planner("parametric", Path("nowhere"), parametric())


def entities(path: Path) -> dict[str, str]:
    """Statistics of each entity by Rerun's tool, which also verifies the file."""
    rerun = Path(sys.executable).parent / "rerun"
    subprocess.run([rerun, "rrd", "verify", path], check=True)
    statistics = subprocess.run([rerun, "rrd", "stats", path], capture_output=True, text=True, check=True).stdout
    return dict(line.split(":", 1) for line in statistics.splitlines() if line.startswith("/"))


def test_a_recording_has_world_plans_vehicle_and_numbers(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun")
    driven = drive_course(PLANNER, SETTINGS, tmp_path / "drive")
    capfd.readouterr()
    recording.record_drive(driven, tmp_path / "drive.rrd")
    assert "WARN" not in capfd.readouterr().err
    found = entities(tmp_path / "drive.rrd")
    assert {f"/world/{name}" for name in ("ground", "course", "driven", "plan", "vehicle", "vehicle/body")} <= set(
        found
    )
    assert {"/speed/driven", "/speed/wanted", "/slip/slip", "/path/error", "/mode/mode", "/events"} <= set(found)
    assert {f"/controls/{name}" for name in ("throttle", "brake", "steer")} <= set(found)
    assert {place.strip("/").split("/")[0] for place in found} >= set(recording.PLOTS), "each plot has its numbers"
