"""The controller between run time and vehicle (arrived, stuck), and faults of the sensors."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from offpiste.closed_loop.lockstep import Fault, PlannerController
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
