"""The robot's clock as the processes read it, and the vehicle's track by it."""

import subprocess
import sys
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from live.made_up_robot import small_settings, write_course, write_rig
from live.test_supervisor import RUN
from offpiste.live.packing import pack_measured, unpacked
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
            """A stamp and a reading come; the robot's time, and why the map no longer fits."""
            part.ring("clock").write(STAMP.pack(stamp, steady[0]))
            still = VehicleReading(stamp, np.zeros(3), np.array((0, 0, 0, 1.0)), np.zeros(3), 0.0, np.zeros(4))
            part.ring("readings").write(pack_measured(still, control=None, came=steady[0]))
            now = part.now()
            return now, feed.update(now)

        assert heard(100.0) == (100.0, "")
        steady[0] += 0.5
        assert (part.now(), feed.update(part.now())) == (100.5, "")
        assert heard(100.2) == (100.5, ""), "the first of a burst after 0.3 s of silence"
        assert heard(100.49) == (100.5, "")
        assert heard(100.52) == (100.52, "")
        assert len(feed.track._readings) == 4
        assert heard(100.1) == (pytest.approx(100.1), "went back"), "this one went back"
        assert len(feed.track._readings) == 1


def test_numbers_that_take_time_are_counted_only_for_a_sign_of_life_that_is_due(tmp_path):
    with part_of(tmp_path) as part:
        asked = []
        for number in range(50):
            part.beat("ready", lambda number=number: asked.append(number) or {"number": number})
        assert asked == [0]
        assert unpacked(part.session.ring("status-map").newest().data)["number"] == 0


def test_what_was_loaded_is_left_alone_and_garbage_behind_it_is_not():
    """Python looks through the oldest objects once there are a quarter more of them than the last time it did."""
    code = """if True:
        import gc
        loaded = [[] for _ in range(400_000)]
        from offpiste.live.part import keep_loaded
        keep_loaded()
        before, held = gc.get_stats()[2]["collections"], [None] * 2000
        for number in range(200_000):
            held[number % 2000] = itself = []
            itself.append(itself)
        print(gc.get_stats()[2]["collections"] - before, len(gc.get_objects()) < 20_000)
    """
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert int(said[0]) >= 1
    assert said[1] == "True"


def test_freed_memory_is_given_back():
    code = """if True:
        import ctypes
        import numpy as np
        from offpiste.live import part

        def resident():
            return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6

        for option in (-3, -1):  # large arrays come from the heap, and stay in it: as holes do
            ctypes.CDLL(None).mallopt(option, 1 << 30)
        part.GIVEN_BACK, freed, before = -1.0, part.FreedMemory(), resident()
        array = np.ones(10_000_000)
        del array
        held = resident() - before
        freed.give_back()
        print(held, resident() - before)
    """
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    held, left = map(float, said)
    assert held > 60
    assert left < 20
