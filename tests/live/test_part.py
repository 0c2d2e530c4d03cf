"""Processes of a drive: clock, track, signs of life, memory, the cropped map, and plans."""

import threading
import time
from contextlib import closing, contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from live.synthetic_robot import START, cloud, live_settings, odometry, plan, planner, reading, small_settings, tree
from offpiste.live.control import Controller, SteadyAges
from offpiste.live.map_and_plan import Plans, _within_reach, codes
from offpiste.live.part import STAMP, Part, TrackFeed
from offpiste.live.reception import Reception
from offpiste.live.replay import StepDriver
from offpiste.live.ring import pack_fields, pack_layers, pack_sensors, packed, unpacked
from offpiste.live.robot_messages import VehicleMessages
from offpiste.live.session import new_session
from offpiste.logs.measurements import Camera, Image
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import load_rig
from offpiste.runtime.estimator import VehicleTrack
from offpiste.runtime.follower import MapState
from offpiste.runtime.perception import codes_of
from offpiste.runtime.plan_maker import Planned
from offpiste.runtime.prediction import reachable
from planning_maps import layers
from runtime.stream import course
from transport.routers import Network, until

COMMANDED = {"applied": np.zeros(3), "driver": {}, "stopping": False, "gear": 1.0, "mode": "driving"}
COMMANDED |= {"course": 1, "progress": 30.0}


@contextmanager
def part_of(folder, name="map", **changed):
    with new_session(live_settings(folder, **changed)) as session:
        yield Part(name, session)


def test_a_late_stamp_is_not_a_clock_that_went_back(tmp_path, monkeypatch):
    steady = [1000.0]
    monkeypatch.setattr("offpiste.live.part.time", SimpleNamespace(monotonic=lambda: steady[0]))
    with part_of(tmp_path, clock="clock") as part:
        feed = TrackFeed(part, ())

        def heard(stamp):
            """Add a stamp and a reading; return the robot's time, and the event that invalidates the map."""
            part.ring("clock").write(STAMP.pack(stamp, steady[0]))
            part.ring("readings").write(pack_fields(reading(stamp), control=None, came=steady[0]))
            now = part.now()
            return now, feed.update(now)

        assert heard(100.0) == (100.0, "")
        steady[0] += 0.5
        assert (part.now(), feed.update(part.now())) == (100.5, "")
        assert heard(100.2) == (100.5, ""), "the first of a burst after 0.3 s of silence"
        assert heard(100.49) == (100.5, "")
        assert heard(100.52) == (100.52, "")
        assert len(feed.track._readings) == 4
        assert heard(100.1) == (pytest.approx(100.1), "went back")
        assert len(feed.track._readings) == 1


def test_ages_by_the_steady_clock_grow_while_stamps_are_constant():
    steady, first, second = SteadyAges(), plan(50.0), plan(50.1)

    def ages(now, state, acting):
        return list(vars(steady.ages(9.9, state, acting, now)).values())

    still = MapState(50.0, np.inf)
    assert ages(10.0, still, None) == pytest.approx([0.1, 0.0, -np.inf, -np.inf])
    assert ages(11.0, still, first) == pytest.approx([1.1, 1.0, -np.inf, 0.0])
    assert ages(12.0, still, first) == pytest.approx([2.1, 2.0, -np.inf, 1.0])
    assert ages(12.5, MapState(50.1, 50.0), second) == pytest.approx([2.6, 0.0, 0.0, 0.0])


def test_signs_of_life_are_cheap_and_large_messages_are_dropped(tmp_path):
    with part_of(tmp_path) as part:
        asked = []
        for number in range(50):
            part.beat("ready", lambda number=number: asked.append(number) or {"number": number})
        assert asked == [0]
        status = part.session.ring("status-map")
        assert unpacked(status.newest().data)["number"] == 0
        part.write("stops", b"x" * 65)
        assert part.dropped == {"stops: larger than its shared memory": 1}
        part._beat = -1.0
        part.beat("full", refused={f"{k}": "x" * 100 for k in range(1000)})
        assert unpacked(status.newest().data)["state"] == "full", "a sign of life without the numbers"


@pytest.mark.parametrize("gear", [1.0, -1.0])
def test_the_cropped_map_contains_the_reach_of_plans_at_the_speed_of_the_course(tmp_path, gear):
    def corners(area):
        ny, nx = area.known.shape
        return area.origin, area.origin + area.resolution * np.array((nx - 1, ny - 1))

    with part_of(tmp_path) as part:
        track, mapped = VehicleTrack(), layers(240)
        for now in (0.0, 0.02):
            track.add(reading(now))
        if gear < 0:
            part.ring("commands").write(packed({"time": 0.02, "gear": gear}))
        (low, high), margin = corners(_within_reach(mapped, track, part, 8.0)), part.settings.runtime.margin
        for ahead in (0.0, 1.5):  # driven since
            state = np.array((gear * ahead, 0.0, 0.0, 0.0, 0.0, 0.0))
            wanted = corners(reachable(mapped, state, 8.0, gear, margin))
            assert (low <= wanted[0]).all()
            assert (high >= wanted[1]).all()
        assert max(gear * low[0], gear * high[0]) >= 8 * 5, "the distance in five seconds"


def test_a_keyframe_is_coded_and_an_image_beside_it_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr("offpiste.live.map_and_plan.load_kernels", lambda *_: None)
    eye = '[cameras.eye]\ntopic = "/image"\ninfo = "/info"\n'
    pixels = np.random.default_rng(0).integers(0, 256, (98, 140, 3), dtype=np.uint8)
    with part_of(tmp_path, more=eye, run="pretrained:proving-ground/dc", actuators=True) as part:
        session, planner = part.session, part.settings.load_planner()
        model = CameraModel(140, 98, np.array([[90.0, 0, 69.5], [0, 90.0, 48.5], [0, 0, 1]]))
        sensors = {"eye": Camera("eye", model, np.eye(4), part.rig.cameras["eye"])}, {}
        session.ring("sensors").write(pack_sensors(sensors))
        process = threading.Thread(target=codes, args=(session,))
        process.start()

        def found():
            now = time.time()
            session.ring("images").write(pack_fields(Image(now - 0.01, "eye", pixels)))
            session.ring("readings").write(pack_fields(reading(now), control=None, came=0.0))
            return [unpacked(entry.data)["codes"] for entry in session.ring("codes").since(0)]

        assert until(lambda: len(found()) > 1, 60, every=0.05)
        session.ring("end").write(b"end")
        process.join()
        first, second, *_ = found()
        image = planner.sensor_setup(*sensors).cameras["eye"].rectifier(pixels)
    np.testing.assert_array_equal(first, codes_of(image, planner.extractor.extract, planner.dynamics.encoder))
    assert second is None


def planned(now, *_, **__):
    """Plan without a map."""
    return Planned(plan(now + 0.2), 0.0)


@contextmanager
def planning(folder):
    """Plans on a straight course, their session, and a function that makes a plan 0.1 s later."""
    with part_of(folder, "plan") as part:
        session, clock = part.session, [100.0]
        session.ring("course").write(pack_fields(course(speed=4.0)))
        part.now = lambda: clock[0]
        plans = Plans(part)
        plans._maker.plan = planned

        def at(x=30.0, *, mapped=True, later=0.1):
            clock[0] += later
            session.ring("commands").write(packed(COMMANDED | {"time": clock[0]}))
            session.ring("readings").write(pack_fields(reading(clock[0], x), control=None, came=0.0))
            if mapped:
                session.ring("map").write(pack_layers(layers(4), scan_time=clock[0]))
            return plans.plan()

        yield plans, at


def test_obsolete_plans_and_commands_are_forgotten_and_the_course_is_continued(tmp_path):
    with planning(tmp_path) as (plans, at):
        plans._maker = SimpleNamespace(plan=planned, map_empty=False, failures=(), forget=lambda: None)
        longest = {"plans": 0, "commands": 0}
        for _ in range(3):  # a log that is played again and again
            for _ in range(60):
                state = at()
                longest["plans"] = max(longest["plans"], len(plans._follower.schedule._plans))
                longest["commands"] = max(longest["commands"], len(plans._feed.track._commands))
            assert state == "ready"
            at(later=-4.0)
        assert longest["plans"] < 10
        assert longest["commands"] < 40
        assert plans._follower.tracker.progress == 30.0, "not the beginning of the course"


def test_after_a_jump_an_old_map_is_not_used(tmp_path):
    with planning(tmp_path) as (_, at):
        at(0.0, mapped=False)
        assert at(0.0) == "ready"
        at(50.0)
        assert at(50.0, mapped=False) == "waits for a map", "the available one belongs to the earlier pose"
        assert at(50.0) == "ready"


def test_in_shadow_mode_plans_begin_from_the_drivers_commands_in_real_time_as_in_a_replay(tmp_path):
    more, commanded = "", {"throttle": 0.7, "brake": 0.1, "steer": -0.3, "gear": -1.0}
    for k, name in enumerate(commanded):
        more += f'[channels.{name}]\ntopic = "/odom"\nfields = ["pose.covariance[{10 + k}]"]\n'

    def messages():
        for row in range(10):
            message = odometry(row / 50, row / 25, 2.0)
            message.pose.covariance[10:14] = list(commanded.values())
            yield START / 1e9 + row / 50, message

    with closing(Network()) as network:
        settings = live_settings(tmp_path, more, network=network, actuators=True)
        vehicle = load_rig(settings.rig)
        reception = Reception(vehicle, settings.course, cameras=False)
        driver = StepDriver(vehicle, planner(), reception, small_settings())
        driver.step([("/tf_static", tree()), ("/points", cloud(0.0))], START / 1e9)
        for now, message in messages():
            step = driver.step([("/odom", message)], now)
        assert step.command.control.tolist() != list(commanded.values())[:3]
        offline = from_driver(driver.runtime.follower, driver.runtime._track, now)
        with new_session(settings) as session:
            parts = {name: Part(name, session) for name in ("control", "plan")}
            controller, plans = Controller(parts["control"]), Plans(parts["plan"])
            session.ring("course").write(pack_fields(reception.course))
            vehicle_messages = VehicleMessages(vehicle)
            for now, message in messages():
                for part in parts.values():
                    part.now = lambda: now  # noqa: B023
                taken = vehicle_messages.take("/odom", message, now)
                given = vehicle_messages.given(now)._asdict()
                session.ring("readings").write(pack_fields(taken, **given, came=time.monotonic()))
                controller.tick()
            plans.plan()
            controller.transport.close()
    real = from_driver(plans._follower, plans._feed.track, now)
    np.testing.assert_allclose(real, offline)
    np.testing.assert_allclose(real, np.tile(list(commanded.values()), (len(real), 1)), rtol=1e-6)
    for follower in (driver.runtime.follower, plans._follower):
        assert (follower.engaged, follower.gear) == (-1.0, 1.0), "its own commands are unchanged"


def from_driver(follower, track, now):
    """Controls and gears of the last rows, and those committed until a plan acts."""
    rows = track.rows(now + 0.02)
    committed = follower.committed(now, now + 0.1, rows)
    before = np.column_stack((rows.control[-3:], rows.gear[-3:]))
    return np.concatenate((before, np.column_stack((committed, np.full(len(committed), rows.gear[-1])))))
