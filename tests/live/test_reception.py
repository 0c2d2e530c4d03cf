"""Courses as they are received: in the frame of the vehicle's poses, and a goal that is not where the vehicle is."""

import numpy as np
import pytest

from live.made_up_robot import ENABLE, START, odometry, rig
from offpiste.live.reception import CourseRequest, Reception
from offpiste.logs.ros.writer import header, make, quaternion, vector
from offpiste.planning.course import Course


def path(frame, stamp=START, end=9.0):
    turn, head = quaternion((0, 0, 0, 1)), header(stamp, frame)
    poses = [make("geometry_msgs/Pose", position=vector((x, 0, 0), "geometry_msgs/Point"), orientation=turn)
             for x in (0.0, end)]  # fmt: skip
    stamped = [make("geometry_msgs/PoseStamped", header=head, pose=pose) for pose in poses]
    return make("nav_msgs/Path", header=head, poses=stamped)


def courses(reception, *messages):
    taken = [one for topic, message in messages for one in reception.take(topic, message, START / 1e9)]
    return [one for one in taken if isinstance(one, Course)]


@pytest.mark.parametrize("course_first", [True, False])
def test_a_path_in_another_frame_than_the_poses_is_refused(course_first):
    heard = [("/plan", path("odom")), ("/odom", odometry(0.0))]
    reception = Reception(rig(), CourseRequest(topic="/plan"), cameras=False)
    assert not courses(reception, *(heard if course_first else reversed(heard)))
    assert "a path in 'odom', the vehicle's poses are in 'map'" in reception.refusals[0]
    reception.sensors.sensors = ({}, {})
    assert reception.waiting_for == f"a course: {reception.refusals[0]}"
    assert reception.vehicle.frame == "map"


@pytest.mark.parametrize("frame", ["map", "/map", ""])
def test_a_path_in_the_frame_of_the_poses_is_taken_also_where_it_comes_before_them(frame):
    for heard in ([path(frame), odometry(0.0)], [odometry(0.0), path(frame)]):
        reception = Reception(rig(), CourseRequest(topic="/plan"), cameras=False)
        topics = ["/plan" if "Path" in one.__msgtype__ else "/odom" for one in heard]
        assert len(courses(reception, *zip(topics, heard, strict=True))) == 1
        assert not reception.refusals


def test_the_same_path_again_is_no_new_course_whatever_its_stamp():
    reception = Reception(rig(), CourseRequest(topic="/plan"), cameras=False)
    later = path("map", START + 10**9)
    assert len(courses(reception, ("/odom", odometry(0.0)), ("/plan", path("map")), ("/plan", later))) == 1
    assert len(courses(reception, ("/plan", path("map", end=8.0)), ("/plan", later))) == 2


@pytest.mark.parametrize(
    ("stamp", "received", "age"),
    [(START, START / 1e9 + 0.5, 0.5), (0, START / 1e9, 0.0), (START, -np.inf, -np.inf), (0, -np.inf, np.nan)],
)
def test_a_switch_has_the_age_of_its_stamp(stamp, received, age):
    reception = Reception(rig(ENABLE + 'field = "buttons[0]"\n'), CourseRequest(topic="/plan"), cameras=False)
    buttons, axes = np.ones(1, np.int32), np.zeros(0, np.float32)
    joy = make("sensor_msgs/Joy", header=header(stamp, ""), axes=axes, buttons=buttons)
    (taken,) = reception.take("/enable", joy, received)
    assert taken.pressed
    assert taken.age == pytest.approx(age, nan_ok=True)


def test_a_goal_where_the_vehicle_is_waits_until_it_is_elsewhere():
    reception = Reception(rig(), CourseRequest(goal=(0.0, 0.02)), cameras=False)
    assert not courses(reception, ("/odom", odometry(0.0)), ("/odom", odometry(0.02)))
    assert len(reception.refusals) == 1
    reception.sensors.sensors = ({}, {})
    assert reception.waiting_for.startswith("a course: ")
    (course,) = courses(reception, ("/odom", odometry(0.04, 5.0)))
    np.testing.assert_allclose(course.path, [[5.0, 0.0], [0.0, 0.02]])
