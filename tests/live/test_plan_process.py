"""The process that plans: what it keeps does not grow, and a course is continued where it was."""

import numpy as np
import torch

from live.made_up_robot import small_settings, write_course, write_rig
from live.test_supervisor import RUN
from offpiste.live.packing import pack_course, pack_measured, packed, unpacked
from offpiste.live.part import Part
from offpiste.live.parts.plan import Plans
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, new_session
from offpiste.planning.course import Course
from offpiste.runtime.course_tracker import CourseTracker
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.plan_maker import Planned
from offpiste.runtime.prediction import Prediction
from offpiste.runtime.schedule import TimedPlan

COMMANDED = {"applied": np.zeros(3), "stopping": False, "gear": 1.0, "mode": "driving", "course": 1, "progress": 30.0}
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


def test_it_keeps_no_plan_that_is_over_and_continues_a_course_where_control_is(tmp_path):
    settings = LiveSettings(write_rig(tmp_path), RUN, None, CourseRequest(write_course(tmp_path)), small_settings())
    with new_session(settings) as session:
        session.ring("course").write(pack_course(STRAIGHT))
        part = Part("plan", session)
        plans = Plans(part)
        plans._maker = Maker()
        clock = [100.0]
        part.now = lambda: clock[0]
        session.ring("commands").write(packed(COMMANDED | {"time": clock[0]}))
        for _ in range(300):
            clock[0] += 0.1
            still = VehicleReading(clock[0], np.array((30.0, 0, 0)), np.array((0, 0, 0, 1.0)), np.zeros(3), 0.0,
                                   np.zeros(4))  # fmt: skip
            session.ring("readings").write(pack_measured(still, control=None, came=0.0))
            plans._layers, plans._scan_time = object(), clock[0]
            state = plans.plan()
        assert state == "ready"
        assert len(plans._follower.schedule._plans) < 10
        assert plans._follower.tracker.progress == 30.0, "and not at the beginning of the course"


def test_what_is_larger_than_the_memory_for_it_is_dropped_and_counted(tmp_path):
    settings = LiveSettings(write_rig(tmp_path), RUN, None, CourseRequest(write_course(tmp_path)), small_settings())
    with new_session(settings) as session:
        part = Part("map", session)
        part.hand_on("stops", b"x" * 65)
        assert part.dropped == {"stops: larger than the shared memory for it": 1}
        part.beat("ready", refused={f"{k}": "x" * 100 for k in range(1000)})
        assert unpacked(session.ring("status-map").newest().data)["state"] == "ready"
