"""The robot's clock as the processes read it, and the vehicle's track by it."""

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from live.made_up_robot import small_settings, write_course, write_rig
from live.test_supervisor import RUN
from offpiste.live.packing import pack_measured
from offpiste.live.part import STAMP, Part, TrackFeed
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, new_session
from offpiste.runtime.estimator import VehicleReading


@contextmanager
def part_of(folder):
    course = CourseRequest(write_course(folder))
    settings = LiveSettings(write_rig(folder), RUN, None, course, small_settings(), clock="clock")
    with new_session(settings) as session:
        yield Part("map", session)


def test_a_stamp_that_comes_late_is_no_clock_that_goes_back(tmp_path, monkeypatch):
    steady = [1000.0]
    monkeypatch.setattr("offpiste.live.part.time", SimpleNamespace(monotonic=lambda: steady[0]))
    with part_of(tmp_path) as part:
        feed = TrackFeed(part, ())

        def heard(stamp):
            """A stamp and a reading come; the robot's time, and whether the map no longer fits."""
            part.ring("clock").write(STAMP.pack(stamp, steady[0]))
            still = VehicleReading(stamp, np.zeros(3), np.array((0, 0, 0, 1.0)), np.zeros(3), 0.0, np.zeros(4))
            part.ring("readings").write(pack_measured(still, control=None, came=steady[0]))
            now = part.now()
            return now, feed.update(now)

        assert heard(100.0) == (100.0, False)
        steady[0] += 0.5
        assert (part.now(), feed.update(part.now())) == (100.5, False)
        assert heard(100.2) == (100.5, False), "the first of a burst after 0.3 s of silence"
        assert heard(100.49) == (100.5, False)
        assert heard(100.52) == (100.52, False)
        assert len(feed.track._readings) == 4
        assert heard(100.1) == (pytest.approx(100.1), True), "this one went back"
        assert len(feed.track._readings) == 1
