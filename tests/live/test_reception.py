"""Courses from files, paths and goals; the dead man's switch; and waiting messages."""

from types import SimpleNamespace

import numpy as np
import pytest

from live.synthetic_robot import ENABLE, RIG, START, odometry, path, rig
from offpiste.core.errors import LiveError
from offpiste.core.geometry import local_from_geographic
from offpiste.live.receive import Backlog
from offpiste.live.reception import CourseRequest, Reception, read_course
from offpiste.logs.ros.writer import header, make
from offpiste.planning.course import Course
from offpiste.rig.rig import parse_rig
from offpiste.transport.received import Received, Tally


def read(folder, text, vehicle=None):
    (folder / "course.csv").write_text(text)
    return read_course(folder / "course.csv", 9.0, vehicle or rig())


@pytest.mark.parametrize(
    ("text", "points", "speed"),
    [
        ("x,y,speed\n0,0,2\n3,4,3\n", [[0, 0], [3, 4]], [2, 3]),
        ("y,x\n0,0\n4,3\n4,3\n", [[0, 0], [3, 4]], [9, 9]),  # repeated points are dropped
        ("\ufeffx,y\n0,0\n3,4\n", [[0, 0], [3, 4]], [9, 9]),  # as Excel saves it
    ],
)
def test_a_table_is_read(tmp_path, text, points, speed):
    course = read(tmp_path, text)
    np.testing.assert_array_equal(course.path, points)
    np.testing.assert_array_equal(course.speed, speed)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "fewer than two distinct points"),
        ("x,y\n1,2\n1.01,2\n", "fewer than two distinct points"),
        ("a,b\n1,2\n3,4\n", "without a number: 'x'"),
        ("x,y\n1,2\nfar,4\n", "without a number"),
        ("x,y\n1,2\nnan,4\n", "is invalid"),
        ("lat,lon\n48.1,11.5\n48.2,11.5\n", "does not define an origin"),
        ("x,y,speed\n1,2,0\n3,4,1\n", "its speed, is invalid"),
        ("x,y,speed\n1,2,99\n3,4,1\n", "its speed, is invalid"),
    ],
)
def test_an_invalid_table_is_refused(tmp_path, text, what):
    with pytest.raises(LiveError, match=what) as raised:
        read(tmp_path, text)
    assert "course.csv" in str(raised.value)
    with pytest.raises(LiveError, match="No such file"):
        read_course(tmp_path / "none.csv", 3.0, rig())


@pytest.mark.parametrize("axes", ["z up", "ned"])
def test_a_table_of_latitudes_and_longitudes(tmp_path, axes):
    entry = '[channels.position]\nunit = "lat lon"\norigin = [48.0, 11.0]\n'
    earth = parse_rig(RIG.replace("[channels.position]\n", entry) + f'\n[motion]\naxes = "{axes}"\n', where="test")
    course = read(tmp_path, "lat,lon,speed\n48,11,2\n48.001,11,3\n", earth)
    north = local_from_geographic(np.array([[48.001, 11.0]]), (48.0, 11.0))[0, 1]
    assert north == pytest.approx(111.2, abs=0.1), "a thousandth of a degree"
    np.testing.assert_allclose(course.path, [[0, 0], (0, north) if axes == "z up" else (north, 0)], atol=1e-6)
    with pytest.raises(LiveError, match=r"km from channels\.position\.origin"):
        read(tmp_path, "lon,lat\n48,11\n48.001,11\n", earth)
    with pytest.raises(LiveError, match="is invalid"):
        read(tmp_path, "lat,lon\n480,11\n48.001,11\n", earth)


@pytest.mark.parametrize(
    "given", [{}, {"topic": "/b", "goal": (1.0, 0.0)}, {"topic": "/b", "speed": 0.0}, {"goal": (np.inf, 0.0)}]
)
def test_an_invalid_request_is_refused(given):
    with pytest.raises(LiveError):
        CourseRequest(**given).check()


def courses(reception, *messages):
    taken = [one for topic, message in messages for one in reception.take(topic, message, START / 1e9)]
    return [one for one in taken if isinstance(one, Course)]


@pytest.mark.parametrize("course_first", [True, False])
def test_a_path_must_be_in_the_frame_of_the_poses(course_first):
    for frame in ("map", "/map", "", "odom"):
        heard = [("/plan", path(frame)), ("/odom", odometry(0.0))]
        reception = Reception(rig(), CourseRequest(topic="/plan"), cameras=False)
        taken = courses(reception, *(heard if course_first else reversed(heard)))
        assert len(taken) == (frame != "odom")
    assert "a path in 'odom', the vehicle's poses are in 'map'" in reception.refusals[0]
    reception.sensors.sensors = ({}, {})
    assert reception.waiting_for == f"a course: {reception.refusals[0]}"


def test_only_a_different_path_is_a_new_course():
    reception = Reception(rig(), CourseRequest(topic="/plan"), cameras=False)
    later, empty = path("map", START + 10**9), SimpleNamespace(header=SimpleNamespace(frame_id="map"), poses=[])
    assert len(courses(reception, ("/odom", odometry(0.0)), ("/plan", path("map")), ("/plan", later))) == 1
    assert len(courses(reception, ("/plan", path("map", end=8.0)), ("/plan", later))) == 2
    assert not courses(reception, ("/plan", empty))
    assert "topic '/plan'" in reception.refusals[-1]


def test_a_course_to_a_goal_begins_at_the_vehicle_once_it_is_elsewhere():
    reception = Reception(rig(), CourseRequest(goal=(0.0, 0.02)), cameras=False)
    assert not courses(reception, ("/odom", odometry(0.0)), ("/odom", odometry(0.02)))
    assert len(reception.refusals) == 1
    reception.sensors.sensors = ({}, {})
    assert reception.waiting_for.startswith("a course: the goal")
    (course,) = courses(reception, ("/odom", odometry(0.04, 5.0)))
    np.testing.assert_allclose(course.path, [[5.0, 0.0], [0.0, 0.02]])


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


def message(topic, size):
    return Received(topic, "", bytes(size), 0.0)


def test_a_full_backlog_drops_the_oldest_message_of_the_largest_topic():
    dropped = Tally()
    backlog = Backlog(3, dropped, size=100, why="too slow")
    for topic, size in (("/scan", 40), ("/scan", 30), ("/image", 45)):
        backlog.put(message(topic, size))
    assert dropped == {"/scan: too slow": 1}, "by size"
    for size in range(3):
        backlog.put(message("/odom", size))
    assert dropped == {"/scan: too slow": 1, "/odom: too slow": 2}, "by number"
    taken = [(one.topic, len(one.data)) for one in (backlog.get(0.0) for _ in range(3))]
    assert taken == [("/scan", 30), ("/image", 45), ("/odom", 2)]
    backlog.put(message("/odom", 1))
    backlog.put(message("/image", 101))
    assert backlog.get(0.0).topic == "/odom", "the only message of another topic is kept"
    assert backlog.get(0.0) is None
