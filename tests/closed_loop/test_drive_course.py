"""A short closed-loop drive: proving ground, sensors, map, plan, log and result."""

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
from offpiste.closed_loop.courses import CourseSettings, choose_course, surprise_along, traction_along
from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
from offpiste.core.channels import MORE_ACTUATORS, Actuator
from offpiste.core.errors import OffpisteError, PlanningError
from offpiste.dynamics import Parametric
from offpiste.logs.drive import read_drive
from offpiste.planning.caution import AddSpread
from offpiste.rig.rig import load_rig
from offpiste.runtime.planner import Planner, load_planner
from offpiste.simulation.world.world import WorldSettings
from runtime.stream import parametric, settings
from simulation.drives import flat_world

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
