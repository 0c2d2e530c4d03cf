"""The controller between run time and vehicle (arrived, stuck), and faults of the sensors."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from offpiste.closed_loop.lockstep import KINDS, Fault, PlannerController
from offpiste.logs.measurements import Cloud, Image
from offpiste.runtime.modes import Controls
from offpiste.runtime.runtime import Runtime
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


def test_a_vehicle_without_progress_for_12_s_is_stuck():
    assert not commanded(11.9).stuck
    assert commanded(12.1).stuck


def test_progress_is_more_than_a_metre():
    assert commanded(20.0, progress=lambda t: 0.04 * t).stuck, "0.8 m in 20 s"
    assert not commanded(20.0, progress=lambda t: 0.2 * t).stuck
    assert not commanded(19.0, progress=lambda t: 2.0 * (t > 7.5)).stuck
    assert commanded(19.8, progress=lambda t: 2.0 * (t > 7.5)).stuck


def test_a_vehicle_that_waits_is_not_stuck():
    waits = commanded(20.0, mode="stopped", why="no scan")
    assert not waits.stuck
    assert not waits.arrived
    assert commanded(20.0, mode="stopping", why="no scan").stuck, "it should be at a standstill by then"


def test_a_vehicle_that_backs_out_is_not_stuck_and_one_that_gave_up_is():
    assert not commanded(20.0, gear=-1.0).stuck
    assert commanded(0.1, mode="stopped", why="stuck").stuck
    assert not commanded(0.1, mode="stopping", why="stuck").stuck


def test_a_vehicle_stopped_at_the_end_has_arrived():
    end = "end of the course"
    assert commanded(0.1, mode="stopped", why=end).arrived
    assert not commanded(0.1, mode="stopping", why=end).arrived


PIXELS = np.zeros((4, 4, 3), np.uint8)


def image(t):
    return Image(t, "eye", PIXELS)


def cloud(t):
    return Cloud(t, "lidar", np.zeros((2, 3)), None, np.zeros(2))


def arriving(kind):
    """Stamps of images and clouds that arrive at each tenth of a second of 3 s; the fault begins at 1 s."""
    fault, images, clouds = Fault(kind, 1.0), [], []
    for row in range(30):
        t = row / 10
        fault.notice(t, 3.0)
        for measured in [*fault.passed(image(t), t), *fault.passed(cloud(t), t)]:
            (images if isinstance(measured, Image) else clouds).append((t, measured.time))
    return images, clouds


def test_dropped_sensors_are_silent_from_then_on():
    images, clouds = arriving("camera-dropped")
    assert (len(images), len(clouds)) == (10, 30)
    images, clouds = arriving("lidar-dropped")
    assert (len(images), len(clouds)) == (30, 10)


def test_late_images_come_with_their_own_stamps():
    images, clouds = arriving("late-image")
    assert len(clouds) == 30
    delays = np.array([arrival - stamp for arrival, stamp in images])
    np.testing.assert_allclose(delays[:10], 0)
    np.testing.assert_allclose(delays[10:], 0.8, atol=1e-9)
    assert [stamp for _, stamp in images] == sorted(stamp for _, stamp in images)


def test_features_break_from_then_on():
    fault = Fault("nan-features", 1.0)
    extract = fault.extractor(lambda pixels: np.ones((2, 2, 3), np.float32))
    fault.notice(0.9, 3.0)
    assert np.isfinite(extract(PIXELS)).all()
    fault.notice(1.0, 3.0)
    assert np.isnan(extract(PIXELS)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_only_the_empty_map_fault_empties_the_map_and_once(kind):
    runtime, fault = Mock(spec=Runtime), Fault(kind, 1.0)
    fault.notice(0.98, 3.0)
    fault.strike(runtime)
    runtime.forget_map.assert_not_called()
    for time in (1.0, 1.02, 5.0):
        fault.notice(time, 3.0)
        fault.strike(runtime)
    assert runtime.forget_map.call_count == (1 if kind == "map-empty" else 0)


def test_a_fault_in_reverse_waits_for_its_time_and_the_gear_and_then_stays():
    fault = Fault("lidar-dropped", 1.0, when="reversing")
    for time, rolling, passes in ((0.5, -2.0, 1), (1.0, 3.0, 1), (1.5, -0.2, 1), (2.0, -0.6, 0), (2.5, 3.0, 0)):
        fault.notice(time, rolling)
        assert len(fault.passed(cloud(time), time)) == passes, time
