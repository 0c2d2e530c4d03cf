"""The controller between run time and vehicle, faults of the sensors, and scores of drives, by hand."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from offpiste.closed_loop import scores
from offpiste.closed_loop.lockstep import Driving, Fault, PlannerController, time_of
from offpiste.closed_loop.scores import (
    Trace,
    driven_cost,
    engine_energy,
    firm_way,
    interventions,
    is_stuck,
    prediction_errors,
    summary,
    trace_of,
)
from offpiste.core.conventions import HORIZON_STEPS
from offpiste.logs.measurements import Cloud, Image
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.course import Course
from offpiste.runtime.modes import Controls
from offpiste.runtime.prediction import Prediction
from offpiste.runtime.runtime import Runtime
from offpiste.simulation.vehicle.parameters import load_vehicle
from synthetic_drive import samples


def commanded(seconds, mode="driving", why="", progress=lambda t: 0.0, gear=1.0):
    """Controller after some seconds in a given mode, with a given progress along the course."""
    tracker, readings = SimpleNamespace(progress=0.0), []

    def command(now):
        return Controls(now, np.array((0.3, 0.0, 0.1)), mode, why, gear)

    runtime = Mock(spec=Runtime, course_tracker=tracker, vehicle=readings.append, step=command)
    controller = PlannerController(runtime, np.random.default_rng(0))
    assert not controller.stuck
    assert not controller.arrived
    like = samples(1.0)[0]
    for row in range(round(seconds / 0.02) + 1):
        tracker.progress = progress(0.02 * row)
        given = controller.command(replace(like, time=0.02 * row))
        np.testing.assert_array_equal(given, (0.3, 0.0, 0.1, gear))
    assert [c.time for c in controller.controls] == [reading.time for reading in readings]
    return controller


@pytest.mark.parametrize(
    ("given", "stuck", "arrived"),
    [
        ((11.9,), False, False),
        ((12.1,), True, False),
        ((20.0, "driving", "", lambda t: 0.04 * t), True, False),  # 0.8 m in 20 s
        ((19.0, "driving", "", lambda t: 2.0 * (t > 7.5)), False, False),
        ((19.8, "driving", "", lambda t: 2.0 * (t > 7.5)), True, False),
        ((20.0, "stopped", "no scan"), False, False),
        ((20.0, "stopping", "no scan"), True, False),  # it should be at a standstill by then
        ((20.0, "driving", "", lambda t: 0.0, -1.0), False, False),  # it backs out
        ((0.1, "stopped", "stuck"), True, False),
        ((0.1, "stopping", "stuck"), False, False),
        ((0.1, "stopped", "end of the course"), False, True),
        ((0.1, "stopping", "end of the course"), False, False),
    ],
)
def test_a_vehicle_without_progress_for_12_s_is_stuck_and_one_stopped_at_the_end_has_arrived(given, stuck, arrived):
    controller = commanded(*given)
    assert (controller.stuck, controller.arrived) == (stuck, arrived)


IMAGE = Image(0.0, "eye", np.zeros((4, 4, 3), np.uint8))
CLOUD = Cloud(0.0, "lidar", np.zeros((2, 3)), None, np.zeros(2))


@pytest.mark.parametrize(
    ("kind", "images", "clouds"),
    [
        ("none", 30, 30),
        ("camera-dropped", 10, 30),
        ("lidar-dropped", 30, 10),
        ("late-image", 22, 30),
        ("nan-features", 30, 30),
        ("map-empty", 30, 30),
    ],
)
def test_faults_drop_delay_or_break_what_arrives_from_their_start_on(kind, images, clouds):
    runtime, fault, arrived = Mock(spec=Runtime), Fault(kind, 1.0), []
    extract = fault.extractor(lambda pixels: np.ones((2, 2, 3), np.float32))
    for row in range(30):  # every 0.1 s
        t = row / 10
        fault.notice(t, 3.0)
        for measured in (replace(IMAGE, time=t), replace(CLOUD, time=t)):
            arrived += [(t, passed) for passed in fault.passed(measured, t)]
        fault.strike(runtime)
        assert np.isfinite(extract(IMAGE.pixels)).all() == (kind != "nan-features" or t < 1)
        assert runtime.forget_map.call_count == (kind == "map-empty" and t >= 1), "once"
    delays = [t - passed.time for t, passed in arrived if isinstance(passed, Image)]
    assert (len(delays), len(arrived) - len(delays)) == (images, clouds)
    np.testing.assert_allclose(delays, 0.8 * (kind == "late-image") * (np.arange(images) >= 10), atol=1e-9)
    heights = [passed.points[0, 2] for _, passed in arrived if isinstance(passed, Cloud)]
    np.testing.assert_array_equal(heights, 1000.0 * (kind == "map-empty") * (np.arange(clouds) >= 10))


def test_a_fault_in_reverse_begins_with_the_next_reversing_and_stays():
    fault = Fault("lidar-dropped", 1.0, when="reversing")
    for time, rolling, passes in ((0.5, -2.0, 1), (1.0, 3.0, 1), (1.5, -0.2, 1), (2.0, -0.6, 0), (2.5, 3.0, 0)):
        fault.notice(time, rolling)
        assert len(fault.passed(CLOUD, time)) == passes, time


WEIGHTS = CostWeights(path=3.0, speed=1.0)
VEHICLE = load_vehicle()
COURSE = Course(np.stack((np.arange(11.0), np.zeros(11)), axis=1), np.full(11, 7.0))
"""10 m along x, at 7 m/s."""


def test_the_driven_cost_by_hand():
    # Two seconds 0.5 m beside the course, at 5 m/s where 7 are wanted: 2 s x (3 x 0.25 + 1 x 4).
    n = 100
    trace = Trace(np.zeros((n, 2)), *(np.full(n, value) for value in (5.0, 0.5, 7.0, 0.0, 0.0)))
    assert driven_cost(trace, None, WEIGHTS) == pytest.approx(2 * (0.75 + 4.0))
    # Not at the end after 10 s: in the other eight it counts as at a standstill where it is.
    assert driven_cost(trace, 10.0, WEIGHTS) == pytest.approx(2 * (0.75 + 4.0) + 8 * (0.75 + 49.0))
    assert driven_cost(trace, 10.0, WEIGHTS, begin=n - 50) == pytest.approx(0.75 + 4.0 + 8 * 49.75)


def prediction(place, first, aside=0.0):
    """Plan that acts from a row on; its last state is `aside` metres to the left of the vehicle 5 s later."""
    state = np.zeros((HORIZON_STEPS, 6))
    state[:, :2] = place[first] + 0.1 * np.arange(1, HORIZON_STEPS + 1)[:, None] * (1, 0) + (0.0, aside)
    return Prediction(time_of(0.02 * first), state)


def test_errors_of_plans_5_s_after_their_start():
    place = 0.1 * np.arange(300)[:, None] * (1, 0)  # 5 m/s along x: a row too early or late would be 0.1 m
    found = prediction_errors([prediction(place, 10), prediction(place, 10, aside=3.0), prediction(place, 49)], place)
    assert found == pytest.approx([0.0, 3.0, 0.0], abs=1e-9)
    speeds_up = place + (np.maximum(np.arange(300) - 260, 0) ** 2)[:, None] * (0.01, 0)
    assert prediction_errors([prediction(place, 20)], speeds_up) == pytest.approx([1.0]), "row 270"


def summed(driving):
    return summary(driving, trace_of(driving, COURSE), 10.0, 2.0, WEIGHTS, VEHICLE)


def hand_made(rows=10):
    """A metre a row along the course, 0.5 m beside it, but 1.5 m in row 3 and 4 m in row 9; it hits a tree in row 4."""
    aside = np.full(10, 0.5)
    aside[3], aside[9] = 1.5, 4.0
    like = samples(1.0)[0]
    truth = replace(like.truth, slip_ratio=np.full(4, -0.3), slip_angle=np.full(4, np.arctan(0.4)))
    like = replace(like, velocity=np.array((3.0, -4.0, 12.0)), truth=truth)
    driven = [replace(like, time=0.02 * row, position=np.array((row, aside[row], 20.0))) for row in range(rows)]
    driven[4:5] = [replace(one, events=("collision with a tree",)) for one in driven[4:5]]
    modes = ["stopped", *(rows - 1) * ["driving"]]
    return Driving(driven, [Controls(time_of(s.time), np.zeros(3), m) for s, m in zip(driven, modes, strict=True)])


def test_the_trace_by_hand():
    trace = trace_of(hand_made(), COURSE)
    np.testing.assert_allclose(trace.place[:, 0], np.arange(10))
    np.testing.assert_allclose(trace.speed, 5.0)  # over ground: the climb does not count
    np.testing.assert_allclose(trace.off, [0.5, 0.5, 0.5, 1.5, 0.5, 0.5, 0.5, 0.5, 0.5, 4.0])
    np.testing.assert_allclose(trace.target, 7.0)
    np.testing.assert_allclose(trace.progress, np.arange(10))
    np.testing.assert_allclose(trace.slip, 0.5)


def test_the_summary_counts_until_the_course_is_driven(monkeypatch):
    monkeypatch.setattr(scores, "RUN_UP", 4.0)
    found = summed(hand_made())
    assert found["finished"], "from row 7 on it is less than 3 m to the end"
    assert found["time_s"] == pytest.approx(8 * 0.02)
    assert found["progress_m"] == 7.0
    assert found["mean_path_error_m"] == pytest.approx((7 * 0.5 + 1.5) / 8)
    assert found["worst_path_error_m"] == 1.5
    assert found["driven_m"] == pytest.approx(5 + 2 * np.sqrt(2))
    assert (found["mean_speed_mps"], found["mean_speed_error_mps"]) == (pytest.approx(5.0), pytest.approx(2.0))
    assert found["driven_cost"] == pytest.approx(0.02 * (3 * (7 * 0.25 + 2.25) + 8 * 4))
    assert found["moving_cost"] == pytest.approx(0.02 * 4 * (3 * 0.25 + 4)), "rows 4 to 7"
    assert found["share_of_time"] == {"driving": 7 / 8, "stopped": 1 / 8}
    assert found["vehicle_events"] == [(0.08, "collision with a tree")]
    assert found["collision"]
    assert found["damage"]
    assert found["interventions"] == 1
    assert not any(found[name] for name in ("rollover", "stuck", "left_world"))


@pytest.mark.parametrize(("row", "counts"), [(7, True), (8, False)])
def test_events_after_the_finish_do_not_count(row, counts):
    driving = hand_made()
    happens = [replace(one, events=()) for one in driving.samples]
    happens[row] = replace(happens[row], events=("rollover", "collision with a tree", "left the world"))
    found = summed(Driving(happens, driving.controls))
    assert {found[name] for name in ("rollover", "collision", "damage", "left_world")} == {counts}
    assert found["interventions"] == 3 * counts
    assert len(found["vehicle_events"]) == 3, "they are named all the same"


def test_a_drive_that_does_not_finish_counts_as_standstill_in_its_cost_alone():
    found = summed(hand_made(rows=3))
    assert not found["finished"]
    assert (found["time_s"], found["progress_m"]) == (pytest.approx(0.06), 2.0)
    assert found["driven_cost"] == pytest.approx(0.06 * (3 * 0.25 + 4) + (2.0 - 0.06) * (3 * 0.25 + 49))
    assert found["moving_cost"] == found["driven_cost"], "it did not get through the run-up"
    assert found["mean_path_error_m"] == pytest.approx(0.5)
    assert found["mean_speed_error_mps"] == pytest.approx(2.0)


def test_the_engines_energy_by_hand():
    like = samples(1.0)[0]
    bend = lambda rpm: (rpm / 60 * 2 * np.pi / VEHICLE.engine_torque_speed - 1) ** 2  # noqa: E731
    full = VEHICLE.engine_torque * (1 - VEHICLE.engine_torque_bend * bend(4000.0))
    assert full > 0
    driven = [replace(like, engine_speed=4000.0, command=np.array((1.0, 0.0, 0.0)))] * 50
    coasted = [replace(like, engine_speed=4000.0, command=np.zeros(3))] * 50  # it brakes, and gives nothing back
    second = full * 4000 / 60 * 2 * np.pi
    assert engine_energy(driven + coasted, VEHICLE) == pytest.approx(second)


def commands(*modes, why="no scan", gear=1.0):
    return [Controls(0.02 * row, np.zeros(3), mode, why, gear) for row, mode in enumerate(modes)]


BEGINS = ("stopped", "stopped", "driving")


def test_interventions_are_stops_and_events():
    assert interventions(commands(*BEGINS), set()) == 0, "at the beginning it is at a standstill"
    stops = commands(*BEGINS, "degraded", "stopping", "stopped", "driving", "stopping")
    assert interventions(stops, set()) == 2
    assert interventions(stops, {"rollover", "stuck"}) == 4
    gives_up = commands(*BEGINS) + commands("stopping", "stopped", why="stuck")
    assert interventions(gives_up, {"stuck"}) == 1, "the stop and the event are one"


def trace(place, progress):
    zeros = np.zeros(len(place))
    return Trace(place, zeros, zeros, zeros, progress, zeros)


def progressing(metres):
    """A drive of 20 s that makes so much progress in its last 12 s."""
    return trace(np.zeros((1000, 2)), 30 + metres * np.clip((np.arange(1000) - 399) / 600, 0, 1))


def test_a_drive_that_gave_up_backed_out_or_stands_at_its_end_is_stuck():
    drives = commands(*BEGINS, *997 * ["driving"], why="")
    assert is_stuck(progressing(0.5), drives, set())
    assert not is_stuck(progressing(5.0), drives, set()), "it drives"
    reversing = drives[:500] + commands("driving", gear=-1.0) + drives[501:]
    assert is_stuck(progressing(5.0), reversing, set()), "it backed out, and did not finish"
    for event in ("rollover", "collision with a tree", "left the world"):
        assert not is_stuck(progressing(0.5), reversing, {event})
    assert not is_stuck(progressing(0.0), drives[:300] + commands(*700 * ["stopped"]), set()), "no scan"
    assert is_stuck(progressing(0.0), commands(*1000 * ["stopped"], why="no plan"), set()), "it never drove"
    assert is_stuck(progressing(5.0), drives, {"stuck", "collision with a tree"})


def test_the_way_is_the_nearer_one_in_the_middle():
    x = np.arange(21.0)
    ways = [np.stack((x, side * 4 * np.sin(np.pi * x / 20) ** 2), axis=1) for side in (1, -1)]
    course = Course(ways[0], np.full(21, 7.0), alternative=ways[1])
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(ways[0], axis=0), axis=1))))

    def way(place, firm, course=course):
        return firm_way(trace(place, length[: len(place)]), course, firm)

    assert way(ways[0], 0)
    assert way(ways[1], 0) is False
    assert way(ways[1], 1)
    assert way(np.where((x < 10)[:, None], ways[1], ways[0]), 0), "where they are farthest apart, it is on the first"
    assert way(ways[0][:10], 0) is None
    assert way(ways[0], None, COURSE) is None
