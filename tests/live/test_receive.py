"""The process that receives."""

import time
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest

from live.synthetic_robot import CLOUD, ODOMETRY, START, Robot, cloud, live_settings, odometry, path
from offpiste.core.conventions import ACTUATORS
from offpiste.core.errors import LiveError
from offpiste.live import receive
from offpiste.live.part import Part
from offpiste.live.reception import CourseRequest
from offpiste.live.ring import unpacked
from offpiste.live.session import new_session
from offpiste.logs.ros.writer import header, make, vector
from offpiste.planning.course import Course
from transport.routers import until

HEADERLESS = """
[channels.throttle]
topic = "/cmd_vel"
fields = ["linear.x"]
[channels.steer_angle]
topic = "/steer"
fields = ["data"]
"""


@contextmanager
def receiving(folder, network, more="", change=lambda text: text, **changed):
    """A receiver, and its process."""
    settings = live_settings(folder, more, network=network, **changed)
    Path(settings.rig).write_text(change(Path(settings.rig).read_text()))
    with new_session(settings) as session:
        part = Part("receive", session)
        receiver = receive.Receiver(part)
        yield receiver, part
        receiver.transport.close()


def reads(receiver, part, publish):
    """Whether a reading arrives."""
    return until(lambda: publish(odometry(0.0)) or (receiver.read(), part.ring("readings").written)[1])


def test_waiting_messages_are_read_at_once_and_silence_ends_the_process(tmp_path, network, monkeypatch):
    monkeypatch.setattr(receive, "DEAF", 0.5)
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
        assert until(lambda: receiver._heard_at < time.monotonic() - 0.5)
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
        robot, rear = Robot(network.session(), scans=1), network.session().publisher("/rear", CLOUD)

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
    change = lambda text: text.replace('"throttle", ', "").replace('"steer_angle", ', "")  # noqa: E731
    with receiving(tmp_path, network, HEADERLESS, change, clock=clock) as (receiver, part):

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
