"""Courses from files, paths and goals; the dead man's switch; waiting messages; and the process that receives."""

import time
from contextlib import contextmanager
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

from live.synthetic_robot import EARTH, ENABLE, ODOMETRY, START, Robot, cloud, joy, live_settings, odometry, path, rig
from offpiste.core.conventions import ACTUATORS
from offpiste.core.errors import LiveError
from offpiste.core.geometry import local_from_geographic
from offpiste.live import receive
from offpiste.live.part import Part
from offpiste.live.receive import Backlog
from offpiste.live.reception import CourseRequest, Reception, read_course
from offpiste.live.ring import unpacked
from offpiste.live.session import new_session
from offpiste.logs.ros.writer import header, make, vector
from offpiste.planning.course import Course
from offpiste.rig.rig import parse_rig
from offpiste.transport.received import Received, Tally
from transport.routers import until


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
    earth = parse_rig(EARTH + f'\n[motion]\naxes = "{axes}"\n', where="test")
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
    (taken,) = reception.take("/enable", joy(stamp, 1), received)
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


HEADERLESS = """
[channels.throttle]
topic = "/cmd_vel"
fields = ["linear.x"]
[channels.steer_angle]
topic = "/steer"
fields = ["data"]
"""


@contextmanager
def receiving(folder, network, more="", **changed):
    """A receiver, and its process."""
    with new_session(live_settings(folder, more, network=network, **changed)) as session:
        part = Part("receive", session)
        receiver = receive.Receiver(part)
        yield receiver, part
        receiver.transport.close()


def reads(receiver, part, publish):
    """Whether a reading arrives."""
    return until(lambda: publish(odometry(0.0)) or (receiver.read(), part.ring("readings").written)[1])


def test_waiting_messages_are_read_at_once_and_silence_ends_the_process(tmp_path, network, monkeypatch):
    with receiving(tmp_path, network) as (receiver, part):
        publish = network.session().publisher("/odom", ODOMETRY)
        receiver.check()
        assert reads(receiver, part, publish)
        before = part.ring("readings").written
        for row in range(1, 6):
            publish(odometry(row / 50))
        assert until(lambda: len(receiver._small) >= 5)
        receiver.check()
        receiver.read()
        assert not receiver._small
        assert part.ring("readings").written >= before + 5
        monkeypatch.setattr(receive, "monotonic", lambda: time.monotonic() + receive.DEAF)
        with pytest.raises(LiveError, match="nothing has been heard"):
            receiver.check()


def test_the_current_course_is_not_begun_again(tmp_path, network):
    with receiving(tmp_path, network) as (_, part):
        assert part.ring("course").written == 1
        again = receive.Receiver(part)
        again._course(again.reception.course)
        assert part.ring("course").written == 1, "neither after a restart nor if it is sent again"
        again._course(Course(again.reception.course.path + 1.0, again.reception.course.speed))
        assert part.ring("course").written == 2
        again.transport.close()


def test_the_state_names_late_optional_sensors_and_refused_messages(tmp_path, network):
    file = tmp_path / "my_msgs" / "msg" / "Odd.msg"
    file.parent.mkdir(parents=True)
    file.write_text("float64 data\n")
    with receiving(tmp_path, network, '[lidars.rear]\ntopic = "/rear"\noptional = true\n') as (receiver, _):
        seconds, odd = count(0.0, 0.5), make("std_msgs/Float64", data=0.0)
        wrong = network.session((file,)).publisher("/odom", "my_msgs/msg/Odd")
        assert receiver.state.startswith("waits for readings")
        assert until(lambda: wrong(odd) or "; refused: /odom: unknown type my_" in receiver.state)
        session = network.session()
        robot, rear = Robot(session, scans=1), session.publisher("/rear", "sensor_msgs/msg/PointCloud2")

        def is_ready():
            robot.publish(next(seconds))
            receiver.read()
            return receiver.state == "ready"

        assert until(is_ready)
        assert until(lambda: rear(cloud(0.0)) or receiver.state.startswith("ready, without rear"))


@pytest.mark.parametrize("clock", ["clock", "stamps"])
def test_messages_without_a_header_have_the_robots_time(tmp_path, network, clock):
    robot, rows = network.session(), count()
    kinds = {"/clock": "rosgraph_msgs/msg/Clock", "/odom": ODOMETRY, "/cmd_vel": "geometry_msgs/msg/Twist",
             "/steer": "std_msgs/msg/Float64"}  # fmt: skip
    publish = {topic: robot.publisher(topic, kind) for topic, kind in kinds.items()}
    twist = make("geometry_msgs/Twist", linear=vector((0.5, 0, 0)), angular=vector((0, 0, 0)))
    with receiving(tmp_path, network, HEADERLESS, clock=clock) as (receiver, part):

        def newest():
            """Publish like a simulator whose time is years in the past, and return the newest reading."""
            seconds = 0.02 * next(rows)
            publish["/clock"](make("rosgraph_msgs/Clock", clock=header(START + round(seconds * 1e9), "").stamp))
            publish["/cmd_vel"](twist)
            publish["/steer"](make("std_msgs/Float64", data=0.1))
            publish["/odom"](odometry(seconds))
            receiver.read()
            entry = part.ring("readings").newest()
            return {"control": None} if entry is None else unpacked(entry.data)

        assert until(lambda: newest()["control"] is not None)
        values = newest()
        assert values["control"].tolist() == [0.5, 0.0, 0.0]
        assert values["actuators"][ACTUATORS.index("steer")] == 0.1
        assert all("without a header stamp" in why for why in receiver.reception.vehicle.dropped)


def test_a_course_that_is_published_once_survives_many_other_messages(tmp_path, network):
    robot = network.session(patient=True)
    with receiving(tmp_path, network, course=CourseRequest(topic="/course")) as (receiver, part):
        odom = robot.publisher("/odom", ODOMETRY)
        assert until(lambda: odom(odometry(0.0)) or len(receiver._small))
        robot.publisher("/course", "nav_msgs/msg/Path", keep=True)(path("map"))
        assert until(lambda: "/course" in receiver._small._waiting)
        for row in range(1000):
            odom(odometry(row / 50))
        assert until(lambda: part.dropped.total() > 500), part.dropped
        receiver.read()
        assert part.ring("course").written == 1, part.dropped
        assert list(part.dropped) == ["/odom: comes faster than it is decoded"]
