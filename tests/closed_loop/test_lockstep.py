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


@pytest.mark.parametrize(
    ("given", "stuck", "arrived"),
    [
        ((11.9,), False, False),
        ((12.1,), True, False),
        ((20.0, "driving", "", lambda t: 0.04 * t), True, False),  # 0.8 m in 20 s
        ((20.0, "driving", "", lambda t: 0.2 * t), False, False),
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


def test_faults_drop_or_delay_messages_and_break_features_from_their_start_on():
    images, clouds = arriving("camera-dropped")
    assert (len(images), len(clouds)) == (10, 30)
    images, clouds = arriving("lidar-dropped")
    assert (len(images), len(clouds)) == (30, 10)
    images, clouds = arriving("late-image")
    assert len(clouds) == 30
    np.testing.assert_allclose([arrival - stamp for arrival, stamp in images], [0.0] * 10 + [0.8] * 12, atol=1e-9)
    fault = Fault("nan-features", 1.0)
    extract = fault.extractor(lambda pixels: np.ones((2, 2, 3), np.float32))
    for time, finite in ((0.9, True), (1.0, False)):
        fault.notice(time, 3.0)
        assert np.isfinite(extract(PIXELS)).all() == finite


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
