"""The process that plans: what it keeps does not grow, and a course is continued where it was."""

import time
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import torch

from live.made_up_robot import START, cloud, odometry, planner, small_settings, tree, write_course, write_rig
from live.test_supervisor import RUN
from offpiste.live.driver import Heard, StepDriver
from offpiste.live.packing import pack_course, pack_layers, pack_measured, packed, unpacked
from offpiste.live.part import Part
from offpiste.live.parts.control import Controller
from offpiste.live.parts.plan import Plans
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.session import LiveSettings, new_session
from offpiste.live.vehicle_messages import VehicleMessages
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.course import Course, CourseTracker
from offpiste.rig.rig import load_rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.plan_maker import Planned
from offpiste.runtime.prediction import Prediction
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import Network

COMMANDED = {"applied": np.zeros(3), "driver": {}, "stopping": False, "gear": 1.0, "mode": "driving"}
COMMANDED |= {"course": 1, "progress": 30.0}
FLAT = np.zeros((3, 4))
LAYERS = TerrainLayers(
    np.zeros(2), 0.5, FLAT, np.zeros((3, 4, 3)), FLAT, FLAT, FLAT, np.zeros((3, 4, 2)), FLAT,
    FLAT == 0, FLAT == 0, FLAT != 0,
)  # fmt: skip
STRAIGHT = Course(np.stack((np.arange(0.0, 60), np.zeros(60)), axis=1), np.full(60, 4.0))


def test_a_tracker_resumes_where_another_was():
    before, after = CourseTracker(STRAIGHT), CourseTracker(STRAIGHT)
    for x in np.arange(0.0, 40.0, 0.5):
        before.move(np.array((x, 0.1)))
    after.move(np.array((39.5, 0.1)))
    assert after.progress < 13, "it looks only a little ahead"
    after.resume(before.progress)
    after.move(np.array((39.5, 0.1)))
    assert after.progress == before.progress
    after.resume(1e9)
    assert after.progress == after.length


class Maker:
    """Makes plans without a map."""

    map_empty, failures = False, ()

    def plan(self, now, *_, **__):
        states = np.tile((0.0, 0, 0, 2.0, 0, 0), (250, 1))
        return Planned(TimedPlan(now + 0.2, now, torch.zeros(250, 3)), Prediction(now + 0.2, states), 0.0)

    def forget(self):
        pass


@contextmanager
def planning(folder):
    """What plans on a straight course, its session, and its clock."""
    settings = LiveSettings(write_rig(folder), RUN, None, CourseRequest(write_course(folder)), small_settings())
    with new_session(settings) as session:
        session.ring("course").write(pack_course(STRAIGHT))
        part, clock = Part("plan", session), [100.0]
        part.now = lambda: clock[0]
        yield Plans(part), session, clock


def plan_at(plans, session, now):
    """A command and a reading come, and a plan is made on a map of that moment."""
    session.ring("commands").write(packed(COMMANDED | {"time": now}))
    place = np.array((30.0, 0, 0)), np.array((0, 0, 0, 1.0))
    session.ring("readings").write(
        pack_measured(VehicleReading(now, *place, np.zeros(3), 0.0, np.zeros(4)), control=None, came=0.0)
    )
    plans._layers, plans._scan_time = object(), now
    return plans.plan()


def test_a_clock_that_goes_back_leaves_no_plans_and_commands_of_before(tmp_path):
    with planning(tmp_path) as (plans, session, clock):
        plans._maker, longest = Maker(), {"plans": 0, "commands": 0}
        for _ in range(4):  # a log, played again and again
            for _ in range(80):
                clock[0] += 0.1
                plan_at(plans, session, clock[0])
                longest["plans"] = max(longest["plans"], len(plans._follower.schedule._plans))
                longest["commands"] = max(longest["commands"], len(plans._feed.track._commands))
            clock[0] -= 4.0
        assert longest["plans"] < 10
        assert longest["commands"] < 40


def test_it_keeps_no_plan_that_is_over_and_continues_a_course_where_control_is(tmp_path):
    with planning(tmp_path) as (plans, session, clock):
        plans._maker = Maker()
        for _ in range(300):
            clock[0] += 0.1
            state = plan_at(plans, session, clock[0])
        assert state == "ready"
        assert len(plans._follower.schedule._plans) < 10
        assert plans._follower.tracker.progress == 30.0, "and not at the beginning of the course"


def test_in_shadow_mode_plans_begin_from_the_drivers_commands_in_real_time_as_in_lockstep(tmp_path):
    more, commanded = "", {"throttle": 0.7, "brake": 0.1, "steer": -0.3}
    for k, name in enumerate(commanded):
        more += f'[channels.{name}]\ntopic = "/odom"\nfields = ["pose.covariance[{10 + k}]"]\n'
    more += '[channels.gear]\ntopic = "/odom"\nfields = ["pose.covariance[13]"]\n'
    file = Path(write_rig(tmp_path, actuators=True))
    file.write_text(file.read_text().replace('"throttle", "brake", "steer"', "") + more)
    vehicle, request = load_rig(file), CourseRequest(write_course(tmp_path))
    reception = Reception(vehicle, request, cameras=False)
    driver = StepDriver(vehicle, planner(), reception, small_settings())

    def messages():
        for row in range(10):
            message = odometry(row / 50, row / 25, 2.0)
            message.pose.covariance[10:14] = [*commanded.values(), -1.0]  # in reverse
            yield START / 1e9 + row / 50, message

    driver.step([Heard("/tf_static", tree(), START / 1e9), Heard("/points", cloud(0.0), START / 1e9)], START / 1e9)
    for now, message in messages():
        step = driver.step([Heard("/odom", message, now)], now)
    assert step.command.control.tolist() != list(commanded.values())
    lockstep = from_driver(driver.runtime.follower, driver.runtime._track, now)

    with closing(Network()) as network:
        robot = ZenohSettings(endpoint=network.endpoint)
        settings = LiveSettings(str(file), RUN, None, request, small_settings(), robot)
        with new_session(settings) as session:
            parts = {name: Part(name, session) for name in ("control", "plan")}
            controller, plans = Controller(parts["control"]), Plans(parts["plan"])
            session.ring("course").write(pack_course(reception.course))
            vehicle_messages = VehicleMessages(vehicle)
            for now, message in messages():
                for part in parts.values():
                    part.now = lambda: now  # noqa: B023
                reading = vehicle_messages.take("/odom", message, now)
                given = vehicle_messages.given(now)._asdict()
                session.ring("readings").write(pack_measured(reading, **given, came=time.monotonic()))
                controller.tick()
            plans.plan()
            controller.transport.close()
    real = from_driver(plans._follower, plans._feed.track, now)
    np.testing.assert_allclose(real, lockstep)
    np.testing.assert_allclose(real, np.tile([*commanded.values(), -1.0], (len(real), 1)), rtol=1e-6)
    for follower in (driver.runtime.follower, plans._follower):
        assert (follower.engaged, follower.gear) == (-1.0, 1.0), "its own commands stay as they were"


def from_driver(follower, track, now):
    """Controls and gears of the last rows, and what is committed until a plan acts."""
    rows = track.rows(now + 0.02)
    committed = follower.committed(now, now + 0.1, rows)
    before = np.column_stack((rows.control[-3:], rows.gear[-3:]))
    return np.concatenate((before, np.column_stack((committed, np.full(len(committed), rows.gear[-1])))))


def test_after_a_jump_a_map_of_before_is_not_taken(tmp_path):
    with planning(tmp_path) as (plans, session, clock):
        plans._maker.plan = Maker().plan

        def plan(x, *, mapped):
            clock[0] += 0.1
            place = np.array((x, 0.0, 0))
            still = VehicleReading(clock[0], place, np.array((0, 0, 0, 1.0)), np.zeros(3), 0.0, np.zeros(4))
            session.ring("readings").write(pack_measured(still, control=None, came=0.0))
            if mapped:
                session.ring("map").write(pack_layers(LAYERS, scan_time=clock[0]))
            return plans.plan()

        plan(0.0, mapped=False)
        assert plan(0.0, mapped=True) == "ready"
        plan(50.0, mapped=True)
        assert plan(50.0, mapped=False) == "waits for a map", "the one that is there is of the pose before"
        assert plan(50.0, mapped=True) == "ready"


def test_what_is_larger_than_the_memory_for_it_is_dropped_and_counted(tmp_path):
    settings = LiveSettings(write_rig(tmp_path), RUN, None, CourseRequest(write_course(tmp_path)), small_settings())
    with new_session(settings) as session:
        part = Part("map", session)
        part.hand_on("stops", b"x" * 65)
        assert part.dropped == {"stops: larger than the shared memory for it": 1}
        part.beat("ready", refused={f"{k}": "x" * 100 for k in range(1000)})
        assert unpacked(session.ring("status-map").newest().data)["state"] == "ready"
