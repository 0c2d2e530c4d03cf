"""Drives of several planners on several courses: each once."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from experiments.closed_loop_table import drives
from experiments.closed_loop_table.drives import NEEDED, Entry, drive_all, entries, places
from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings, settings_of
from offpiste.core.errors import CourseError, OffpisteError, RunError
from offpiste.planning.costs.layers import Hazards
from offpiste.runtime.planner import Planner
from offpiste.runtime.settings import RuntimeSettings
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings
from offpiste.uncertainty.spread import Spread
from runtime.stream import parametric

B, DC = (Planner(name, Path(f"/runs/{name}"), parametric()) for name in ("b", "dc"))


@pytest.fixture
def driven(monkeypatch):
    """Drives that only record their settings; `driven.bad` holds worlds without a course."""
    done = SimpleNamespace(drives=[], kinds=[], bad=set())

    def drive_course(planner, settings, folder, *, world, scene):
        if settings.world.seed in done.bad:
            raise CourseError("no stretch of its trails makes a course")
        assert not folder.exists(), "what an interrupted drive left"
        folder.mkdir(parents=True)
        done.kinds.append(settings.course.kind)
        done.drives.append((planner.name, settings.world.preset, settings.world.seed, settings.runtime.latency))
        result = {**dict.fromkeys(NEEDED, 0), **settings_of(planner, settings)}
        (folder / "result.json").write_text(json.dumps(result))
        return SimpleNamespace(result=result)

    monkeypatch.setattr(drives, "drive_course", drive_course)
    small = make_world(WorldSettings("mojave", size=80.0, resolution=1.0))
    monkeypatch.setattr(drives, "course_world", lambda place, kind: small)
    monkeypatch.setattr(drives, "described", lambda result: "driven")
    return done


def test_every_planner_drives_every_course_once(driven, tmp_path):
    rows, worlds = entries([B, DC], (0.3,)), places(1, 2)
    (tmp_path / "b-100ms-0" / "bends-mojave-1").mkdir(parents=True)  # interrupted
    found = drive_all(rows, worlds, tmp_path)
    courses = [("mojave", 1), ("halter-ranch", 2)]
    planned = [("b", 0.1), ("dc", 0.1), ("dc", 0.3)]
    assert driven.drives == [(name, *course, latency) for course in courses for name, latency in planned]
    assert [result["row"] for result in found] == 2 * ["b-100ms", "dc-100ms", "dc-300ms"]
    assert drive_all(rows, worlds, tmp_path) == found
    assert len(driven.drives) == 6, "nothing is driven twice"


def test_a_world_without_a_course_is_left_out(driven, tmp_path):
    driven.bad.add(1)
    found = drive_all([Entry(B)], places(1, 3), tmp_path)
    assert [seed for _, _, seed, _ in driven.drives] == [2, 3]
    assert len(found) == 2
    with pytest.raises(CourseError, match="no stretch"):
        drive_all([Entry(B)], places(1, 1), tmp_path / "alone")


@pytest.mark.parametrize(
    ("other", "what"),
    [
        ({"rows": [Entry(Planner("b", Path("/runs/another"), parametric()))]}, "run"),
        ({"settings": CourseDriveSettings(course=CourseSettings(speed=3.0))}, "course"),
        ({"settings": CourseDriveSettings(runtime=RuntimeSettings(hazards=Hazards(obstacle=1.0)))}, "runtime"),
        ({"settings": CourseDriveSettings(sensors="full")}, "sensors"),
        ({"rows": [Entry(replace(B, weights="trained anew"))]}, "weights"),
    ],
)
def test_a_folder_of_other_drives_is_refused(driven, tmp_path, other, what):
    given = {"rows": [Entry(B)], "worlds": places(1, 1), "out": tmp_path, "settings": CourseDriveSettings()}
    drive_all(**given)
    with pytest.raises(RunError, match=f"another {what}"):
        drive_all(**given | other)


@pytest.mark.parametrize(
    ("content", "what"),
    [("", "cannot be read"), ('{"world": "moj', "cannot be read"), ("[]", "not the result"), ("{}", "lacks 'world'")],
)
def test_a_broken_result_is_named(driven, tmp_path, content, what):
    path = tmp_path / "b-100ms-0" / "bends-mojave-1" / "result.json"
    path.parent.mkdir(parents=True)
    path.write_text(content)
    with pytest.raises(OffpisteError, match=rf"bends-mojave-1/result\.json: .*{what}.*; remove it"):
        drive_all([Entry(B)], places(1, 1), tmp_path)


def test_two_runs_of_one_model_and_seed_are_refused():
    other = Planner("dc", Path("/runs/again"), parametric())
    with pytest.raises(OffpisteError, match=r"/runs/dc and /runs/again: both are 'dc' of seed 0.*another --out"):
        entries([B, DC, other])
    with pytest.raises(OffpisteError, match="both are 'b' of seed 0"):
        entries([B, replace(B)])


@pytest.mark.parametrize("latency", [0.03, -0.1, 1.02, float("nan")])
def test_all_settings_are_checked_before_the_first_course(driven, tmp_path, latency):
    with pytest.raises(OffpisteError, match="invalid latency of"):
        drive_all(entries([DC], (latency,)), places(1, 2), tmp_path)
    assert not driven.drives


def test_a_risk_is_a_row_of_its_own_and_needs_a_spread():
    rows = entries([B, replace(DC, spread=Spread(1))], (0.3,), ("none", "spread:1"))
    assert [row.row for row in rows] == ["b-100ms", "dc-100ms", "dc-300ms", "dc+spread-1-100ms"]
    with pytest.raises(OffpisteError, match=r"--risks: none of the runs has a spread for spread:1; .*calibrate"):
        entries([B, DC], (), ("spread:1",))
