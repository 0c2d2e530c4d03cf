"""Faults, each driven at each moment, and the table of what came of it."""

import json
from pathlib import Path
from typing import Any

import pytest

from experiments.closed_loop_table import faults
from experiments.closed_loop_table.drives import places
from experiments.closed_loop_table.faults import MOMENTS, drive_faults
from offpiste.closed_loop.drive_course import CourseDriveSettings
from offpiste.closed_loop.lockstep import KINDS
from offpiste.runtime.planner import Planner
from runtime.stream import parametric

RESULT = {"row": "b-100ms", "world": "mojave", "seed": 1, "course_m": 100.0, "left_world": False}


def test_each_fault_is_driven_at_each_moment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    driven = {}

    def drive(rows: Any, worlds: Any, out: Path, settings: CourseDriveSettings, *, processes: int) -> list[Any]:
        driven[out.name] = settings
        stops = settings.fault == "lidar-dropped"
        came = {"modes": [(0.0, "driving", ""), (1.5, "stopping", "no scan")][: 1 + stops], "final_speed_mps": 4.0}
        damage = {"rollover": settings.against and stops, "collision": settings.against and stops}
        return [{**RESULT, "fault": settings.fault, "progress_m": 130.0 - 80 * stops, **came, **damage}]

    monkeypatch.setattr(faults, "drive_all", drive)
    table = drive_faults(
        [Planner("b", tmp_path, parametric())], places(1, 1), tmp_path, CourseDriveSettings(), processes=1
    )
    assert len(driven) == len(KINDS) * len(MOMENTS)
    in_reverse = driven["lidar-dropped-reversing"]
    assert (in_reverse.against, in_reverse.fault_start, in_reverse.fault_when) == (True, 0.0, "reversing")
    assert (driven["lidar-dropped-standing"].fault_start, driven["lidar-dropped-standing"].against) == (0.0, False)
    assert driven["lidar-dropped"] == CourseDriveSettings(fault="lidar-dropped")
    line = next(line for line in table.splitlines() if "lidar-dropped" in line and "reversing" in line)
    assert "1.5 s stopping: no scan" in line
    assert "rollover, collision" in line
    assert " 50 " in line
    results = json.loads((tmp_path / "faults" / "faults.json").read_text("utf-8"))["results"]
    assert [result["moment"] for result in results] == [moment for moment in MOMENTS for _ in KINDS]
    assert " 100 " in (tmp_path / "faults" / "faults.md").read_text("utf-8"), "driven behind the end of the course"
