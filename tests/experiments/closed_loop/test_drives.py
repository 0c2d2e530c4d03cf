"""Drives of several planners on several courses: each once."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from offpiste.errors import OffpisteError, RunError
from offpiste.experiments.closed_loop import drives
from offpiste.experiments.closed_loop.courses import CourseSettings
from offpiste.experiments.closed_loop.drive_course import CourseDrive, settings_of
from offpiste.experiments.closed_loop.drives import Entry, drive_all, entries, places
from offpiste.experiments.closed_loop.planner import Planner
from offpiste.planning.course import Hazards
from offpiste.planning.runtime import RuntimeSettings
from offpiste.simulation.build import make_world
from offpiste.simulation.world import WorldSettings
from planning.stream import parametric

B, DC = (Planner(name, Path(f"/runs/{name}"), parametric()) for name in ("b", "dc"))


@pytest.fixture
def driven(monkeypatch):
    """Drives that only say what they were asked for; `driven.bad` holds worlds without a course."""
    done = SimpleNamespace(drives=[], bad=set())

    def drive_course(planner, asked, folder, *, world, scene):
        if asked.world.seed in done.bad:
            raise OffpisteError("no course can be laid")
        assert not folder.exists(), "what an interrupted drive left"
        folder.mkdir(parents=True)
        done.drives.append((planner.name, asked.world.preset, asked.world.seed, asked.runtime.latency))
        result = settings_of(planner, asked)
        (folder / "result.json").write_text(json.dumps(result))
        return SimpleNamespace(result=result)

    monkeypatch.setattr(drives, "drive_course", drive_course)
    small = make_world(WorldSettings("mojave", size=80.0, resolution=1.0))
    monkeypatch.setattr(drives, "make_world", lambda place: small)
    monkeypatch.setattr(drives, "described", lambda result: "driven")
    return done


def test_every_planner_drives_every_course_once(driven, tmp_path):
    rows, worlds = entries([B, DC], (0.3,)), places(1, 2)
    (tmp_path / "b-100ms" / "mojave-1").mkdir(parents=True)  # interrupted
    found = drive_all(rows, worlds, tmp_path)
    courses = [("mojave", 1), ("halter-ranch", 2)]
    planned = [("b", 0.1), ("dc", 0.1), ("dc", 0.3)]
    assert driven.drives == [(name, *course, latency) for course in courses for name, latency in planned]
    assert [result["row"] for result in found] == 2 * ["b-100ms", "dc-100ms", "dc-300ms"]
    assert drive_all(rows, worlds, tmp_path) == found
    assert len(driven.drives) == 6, "nothing is driven twice"


def test_a_course_that_cannot_be_laid_stops_no_other(driven, tmp_path):
    driven.bad.add(1)
    with pytest.raises(OffpisteError, match="no course"):
        drive_all([Entry(B)], places(1, 3), tmp_path)
    assert [seed for _, _, seed, _ in driven.drives] == [2, 3]


@pytest.mark.parametrize(
    ("other", "what"),
    [
        ({"rows": [Entry(Planner("b", Path("/runs/another"), parametric()))]}, "run"),
        ({"asked": CourseDrive(course=CourseSettings(speed=3.0))}, "course"),
        ({"asked": CourseDrive(course=CourseSettings(traction=0.1))}, "course"),
        ({"asked": CourseDrive(runtime=RuntimeSettings(hazards=Hazards(obstacle=1.0)))}, "runtime"),
        ({"asked": CourseDrive(seconds=10.0)}, "limit_s"),
    ],
)
def test_a_folder_of_other_drives_is_refused(driven, tmp_path, other, what):
    given = {"rows": [Entry(B)], "worlds": places(1, 1), "out": tmp_path, "asked": CourseDrive()}
    drive_all(**given)
    with pytest.raises(RunError, match=f"another {what}"):
        drive_all(**given | other)
