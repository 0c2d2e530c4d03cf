"""Courses in synthetic worlds with a known best one, and a short closed-loop drive with its log and result."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from experiments.closed_loop_table.drives import NEEDED
from offpiste._version import commit, today
from offpiste.cli.drive import Drive
from offpiste.closed_loop.courses import (
    PASSAGE_TRACTION,
    RELIEF,
    RUN_OUT,
    CourseSettings,
    choose_course,
    course_world,
    surprise_along,
    traction_along,
)
from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
from offpiste.core.channels import MORE_ACTUATORS, Actuator
from offpiste.core.errors import OffpisteError, PlanningError
from offpiste.dynamics import Parametric
from offpiste.logs.drive import read_drive
from offpiste.planning.caution import AddSpread
from offpiste.rig.rig import load_rig
from offpiste.runtime.planner import Planner, load_planner
from offpiste.simulation.world.forks import ASIDE, WEAVE
from offpiste.simulation.world.world import WorldSettings
from runtime.stream import parametric, settings
from simulation.drives import flat_world

PLACE = WorldSettings("mojave", seed=5, resolution=0.5)


def circle(x, radius=50.0):
    angle = np.linspace(0, 2 * np.pi, 628, endpoint=False)
    return radius * np.stack((np.cos(angle), np.sin(angle)), axis=1) + (x, 0.0)


def made_up(sinkage):
    """A plain with a circle of trail on either side: on ordinary ground where x > 0, and soft where x < 0."""
    world = flat_world(properties=(0.5, 6.0, 0.05, 0.0), size=(240.0, 240.0))
    world.properties[:, :120, 3] = sinkage
    return replace(world, trails=(circle(-60.0), circle(60.0)))


def test_a_passage_leads_through_the_softest_ground_that_can_be_driven():
    settings = CourseSettings("passages")
    soft = choose_course(made_up(sinkage=0.5 - 0.05 - PASSAGE_TRACTION - 0.01), 1, settings).course
    assert soft.path[:, 0].max() < 0
    impassable = choose_course(made_up(sinkage=0.5 - 0.05 - PASSAGE_TRACTION + 0.01), 1, settings).course
    assert impassable.path[:, 0].min() > 0


def test_passages_lie_in_hills_twice_as_high_and_are_the_same_for_a_seed():
    world = course_world(PLACE, "passages")
    assert world.settings == replace(PLACE, relief=RELIEF)
    first, second = (choose_course(world, 5, CourseSettings("passages")).course for _ in range(2))
    np.testing.assert_array_equal(first.path, second.path)
    assert traction_along(world, first.driven).min() >= PASSAGE_TRACTION


def test_a_choice_has_two_ways_of_one_length_and_knows_the_firm_one():
    world = course_world(PLACE, "choices")
    chosen = choose_course(world, 5, CourseSettings("choices"))
    course = chosen.course
    np.testing.assert_array_equal(course.path, choose_course(world, 5, CourseSettings("choices")).course.path)
    first, second = (way[course.before_end] for way in course.ways)
    lengths = [np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in (first, second)]
    assert lengths[0] == pytest.approx(lengths[1], abs=3.0)
    apart = np.linalg.norm(course.path - course.alternative, axis=1)
    assert apart.max() == pytest.approx(2 * (ASIDE + WEAVE), abs=0.2)
    assert apart[:38].max() < 0.01, "before the fork"
    assert apart[-round(RUN_OUT) - 25 :].max() < 0.01, "behind it"
    least = [traction_along(world, way).min() for way in (first, second)]
    assert least[chosen.firm] > least[1 - chosen.firm] >= CourseSettings().traction
    trails = np.concatenate(world.trails)
    for way in course.ways:
        assert np.linalg.norm(way[:, None] - trails[None], axis=-1).min(axis=1).max() < 0.5
        assert np.linalg.norm(np.diff(way, axis=0), axis=1) == pytest.approx(1.0, abs=0.35)
    heading = np.array((np.cos(chosen.start.yaw), np.sin(chosen.start.yaw)))
    assert (course.path[3] - course.path[0]) @ heading > 2.9


def test_a_world_without_forks_and_an_unknown_kind_are_one_line():
    with pytest.raises(
        OffpisteError, match=r"'uniform', seed 0: no stretch of trail is suitable for a course \(choices\)"
    ):
        choose_course(made_up(0.0), 1, CourseSettings("choices"))
    with pytest.raises(OffpisteError, match=r"'choice'.*choices"):
        course_world(PLACE, "choice")


WORLD = WorldSettings("mojave", seed=3, size=120.0, resolution=0.5)
SETTINGS = CourseDriveSettings(
    WORLD, seconds=5.6, course=CourseSettings(speed=5.0, length=60.0, candidates=6), runtime=settings()
)
PLANNER = Planner("parametric", Path("nowhere"), parametric())


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    out = tmp_path_factory.mktemp("closed-loop") / "drive"
    out.mkdir()
    for name in (".drive.png.left.partial", ".offpiste-drive", "drive.mcap"):
        (out / name).write_bytes(b"of a drive that was killed")
    return drive_course(PLANNER, SETTINGS, out), out


def test_it_drives_along_the_course(driven):
    result = driven[0].result
    assert result["progress_m"] > 8.0
    assert result["worst_path_error_m"] < 3.0
    assert not result["rollover"]
    assert not result["stuck"]
    assert result["modes"][-1][1:] == ("driving", "")
    assert result["failed_plans"] == 0
    assert result["plan_error_5s_m"]["n"] > 0


def test_a_vehicle_against_its_course_turns_round_and_stops_where_the_lidar_is_lost_in_reverse(tmp_path):
    turned = replace(SETTINGS, seconds=9.0, against=True, keep_log=False)
    lost = replace(turned, fault="lidar-dropped", fault_start=0.0, fault_when="reversing")
    driven = drive_course(load_planner("pretrained:proving-ground/b"), lost, tmp_path / "drive")
    start, end = driven.driving.samples[0], driven.driving.samples[-1]
    forwards = Rotation.from_quat(start.orientation).apply((1.0, 0.0, 0.0))[:2]
    assert forwards @ (driven.chosen.course.path[1] - driven.chosen.course.path[0]) < 0
    backwards = next(s.time for s in driven.driving.samples if s.gear < 0 and s.wheel_speed.mean() < -0.5)
    stopped = [time for time, mode, why in driven.result["modes"] if mode != "driving" and "scan" in why]
    assert backwards < stopped[-1] < backwards + 2
    assert np.linalg.norm(end.velocity) < 0.1


def test_log_picture_and_result_are_written(driven):
    _, out = driven
    result = json.loads((out / "result.json").read_text())
    assert (result["planner"], result["fault_start"], result["sensors"]) == ("parametric", 10.0, "light")
    assert (result["commit"], result["date"]) == (commit(), today())
    assert set(NEEDED) <= set(result), "what resuming needs of a result"
    assert sorted(file.name for file in out.iterdir()) == ["drive.mcap", "drive.png", "result.json"]
    assert (out / "drive.png").stat().st_size > 10_000
    drive = read_drive(out / "drive.mcap", load_rig("proving_ground"))
    recorded = drive.channels["throttle"]
    given = np.array([c.command[0] for c in driven[0].driving.controls])
    np.testing.assert_allclose(recorded.values[:, 0], given, atol=1e-6)
    with pytest.raises(OffpisteError, match="exists already"):
        drive_course(PLANNER, SETTINGS, out)


def test_a_course_is_on_a_trail_that_can_be_driven_and_the_same_for_a_seed(driven):
    world, chosen = driven[0].world, driven[0].chosen
    assert traction_along(world, chosen.course.driven).min() >= SETTINGS.course.traction
    again = choose_course(world, 3, SETTINGS.course)
    np.testing.assert_array_equal(chosen.course.path, again.course.path)
    trails = np.concatenate(world.trails)
    away = np.linalg.norm(chosen.course.path[:, None] - trails[None], axis=-1).min(axis=1)
    assert away.max() < 0.5
    assert np.linalg.norm(np.diff(chosen.course.path, axis=0), axis=1) == pytest.approx(1.0, abs=0.05)
    assert chosen.surprise == pytest.approx(surprise_along(world, chosen.course.driven, SETTINGS.course.speed))
    assert chosen.course.end == pytest.approx(driven[0].result["course_m"], abs=0.5)
    assert len(chosen.course.driven) < len(chosen.course.path) - 30, "what lies beyond the end is known"


def test_the_surprise_by_hand():
    half = flat_world(properties=(0.4, 6.0, 0.05, 0.0), size=(80.0, 80.0))
    half.properties[:, :40, 0] = 0.8  # for x < 0; the mean is 0.5975
    angle = np.linspace(-0.4, 0.4, 25)  # an arc of 30 m radius, all of it on one side
    arc = 30 * np.stack((np.cos(angle) - 1, np.sin(angle)), axis=-1) - (5, 0)
    allowed = [np.sqrt(mu * 9.81 * 30) for mu in (0.8, half.properties[..., 0].mean())]
    assert surprise_along(half, arc, 100.0) == pytest.approx(allowed[0] - allowed[1], rel=0.02)
    assert surprise_along(half, arc, 10.0) == 0, "nothing is lost where both allow the wanted speed"


def test_the_traction_by_hand():
    hill = flat_world(properties=(0.5, 6.0, 0.1, 0.05), slope=0.2)
    east = np.stack((np.arange(-20.0, 21.0), np.full(41, 3.0)), axis=-1)
    assert traction_along(hill, east) == pytest.approx(0.35 - 0.2, abs=1e-5)
    assert traction_along(hill, east[::-1]) == pytest.approx(0.35 + 0.2, abs=1e-5)
    assert traction_along(hill, east[:, ::-1]) == pytest.approx(0.35, abs=1e-5)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"seconds": float("nan")}, "invalid time limit of nan s"),
        ({"course": CourseSettings(speed=31.0)}, "invalid target speed of 31 m/s"),
        ({"fault_when": "backwards"}, "unknown beginning of a fault, 'backwards'"),
        ({"fault_start": float("nan")}, "invalid start of a fault at nan s"),
        ({"sensors": "heavy"}, "no sensor profile"),
        ({"fault": "late-image"}, r"invalid start of a fault at 10 s.*before the drive's end"),
        ({"runtime": replace(SETTINGS.runtime, risk=AddSpread(1.0))}, "the risk 'spread' needs a spread"),
    ],
)
def test_settings_out_of_range_are_refused_before_a_world_is_built(changed, message, tmp_path, monkeypatch):
    monkeypatch.setattr("offpiste.closed_loop.drive_course.course_world", None)
    with pytest.raises(OffpisteError, match=message):
        drive_course(PLANNER, replace(SETTINGS, **changed), tmp_path)


def test_a_model_of_unmeasured_actuators_is_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(MORE_ACTUATORS._entries, "flap", Actuator("flap", channel="flap"))
    model = Parametric(replace(PLANNER.dynamics.vehicle, actuators=("flap",)))
    with pytest.raises(OffpisteError, match="nowhere: the model reads flap, which the simulated vehicle does not"):
        drive_course(replace(PLANNER, dynamics=model), SETTINGS, tmp_path)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_refused_before_a_world_is_built(tmp_path, monkeypatch):
    monkeypatch.setattr("offpiste.closed_loop.drive_course.drive_course", None)
    with pytest.raises(PlanningError, match="no GPU 'cuda' for planning"):
        Drive(Path("pretrained:proving-ground/b"), device="cuda", out=tmp_path / "drive").run()
