"""Controller between run time and vehicle: when it has arrived, and when it is stuck."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np

from offpiste.closed_loop.lockstep import PlannerController
from offpiste.runtime.modes import Controls
from offpiste.runtime.runtime import Runtime
from synthetic_drive import samples


def commanded(seconds, mode="driving", why="", progress=lambda t: 0.0, gear=1.0):
    """Controller after some seconds in a given mode, with a given progress along the course."""
    tracker, readings = SimpleNamespace(progress=0.0), []

    def command(now):
        return Controls(now, np.array((0.3, 0.0, 0.1)), mode, why, gear)

    runtime = Mock(spec=Runtime, course_tracker=tracker, vehicle=readings.append, command=command)
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
