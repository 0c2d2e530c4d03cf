"""The process that receives: it does not wait for ever on a connection whose thread has ended."""

import time
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest

from live.made_up_robot import START, cloud, odometry, small_settings, tree, write_course, write_rig
from live.test_reception import path
from live.test_supervisor import RUN
from offpiste.core.conventions import ACTUATORS
from offpiste.core.errors import LiveError
from offpiste.live.packing import unpacked
from offpiste.live.part import Part
from offpiste.live.parts import receive
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, new_session
from offpiste.live.vehicle_messages import NO_STAMP
from offpiste.logs.ros.writer import header, make, vector
from offpiste.planning.course import Course
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import network, until

__all__ = ["network"]

ODOMETRY = "nav_msgs/msg/Odometry"


HEADERLESS = """
[channels.throttle]
topic = "/cmd_vel"
fields = ["linear.x"]
[channels.steer_angle]
topic = "/steer"
fields = ["data"]
"""


@contextmanager
def receiving(folder, network, clock="system", request=None):
    """The part of a session, whose rig is in the folder."""
    robot, request = ZenohSettings(endpoint=network.endpoint), request or CourseRequest(write_course(folder))
    rig = str(folder / "rig.toml")
    with new_session(LiveSettings(rig, RUN, None, request, small_settings(), robot, clock=clock)) as session:
        yield Part("receive", session)


@pytest.fixture
def part(tmp_path, network):
    write_rig(tmp_path)
    with receiving(tmp_path, network) as part:
        yield part


def test_where_nothing_is_heard_any_more_it_ends_and_is_started_again(part, network, monkeypatch):
    monkeypatch.setattr(receive, "DEAF", 0.3)
    receiver = receive.Receiver(part, cameras=False)
    publish = network.session().publisher("/odom", ODOMETRY)
    receiver.check()
    assert until(lambda: publish(odometry(0.0)) or (receiver.read(), part.ring("readings").written)[1])
    receiver.check()

    def deaf():
        with pytest.raises(LiveError, match="nothing has been heard"):
            receiver.check()
        return True

    assert until(lambda: receiver._heard_at < time.monotonic() - 0.3)
    assert deaf()
    receiver.transport.close()


def test_a_course_that_is_driven_already_is_not_begun_again(part):
    first = receive.Receiver(part, cameras=False)
    assert part.ring("course").written == 1
    again = receive.Receiver(part, cameras=False)
    assert part.ring("course").written == 1, "it was only started again"
    again._course(again.reception.course)
    assert part.ring("course").written == 1, "it is only sent again, as planners do"
    again._course(Course(again.reception.course.path + 1.0, again.reception.course.speed))
    assert part.ring("course").written == 2
    first.transport.close()
    again.transport.close()


def test_an_optional_sensor_that_comes_too_late_is_named(part, network, tmp_path):
    write_rig(tmp_path, '[lidars.rear]\ntopic = "/rear"\noptional = true\n')
    receiver, robot, seconds = receive.Receiver(part, cameras=False), network.session(), count(0.0, 0.5)
    odom = robot.publisher("/odom", ODOMETRY)
    points, rear = (robot.publisher(topic, "sensor_msgs/msg/PointCloud2") for topic in ("/points", "/rear"))
    robot.publisher("/tf_static", "tf2_msgs/msg/TFMessage", keep=True)(tree())

    def is_ready():
        points(cloud(0.0))
        odom(odometry(next(seconds)))
        receiver.read()
        return receiver.state == "ready"

    assert receiver.state.startswith("waits for readings")
    assert until(is_ready)
    assert until(lambda: rear(cloud(0.0)) or receiver.state.startswith("ready, without rear"))
    receiver.transport.close()


def test_what_the_transport_refused_is_named_while_it_waits(part, network, tmp_path):
    file = tmp_path / "my_msgs" / "msg" / "Odd.msg"
    file.parent.mkdir(parents=True)
    file.write_text("float64 data\n")
    receiver, wrong = (
        receive.Receiver(part, cameras=False),
        network.session((file,)).publisher("/odom", "my_msgs/msg/Odd"),
    )
    assert until(
        lambda: wrong(make("std_msgs/Float64", data=0.0)) or "; refused: /odom: unknown type my_" in receiver.state
    )
    receiver.transport.close()


@pytest.mark.parametrize("clock", ["clock", "stamps"])
def test_messages_without_a_header_are_of_the_robots_time(tmp_path, network, clock):
    file = Path(write_rig(tmp_path, HEADERLESS))
    file.write_text(file.read_text().replace('"throttle", ', "").replace('"steer_angle", ', ""))
    robot, rows = network.session(), count()
    publish = {
        topic: robot.publisher(topic, f"{kind[0]}/msg/{kind[1]}")
        for topic, kind in {
            "/clock": ("rosgraph_msgs", "Clock"),
            "/odom": ("nav_msgs", "Odometry"),
            "/cmd_vel": ("geometry_msgs", "Twist"),
            "/steer": ("std_msgs", "Float64"),
        }.items()
    }
    twist = make("geometry_msgs/Twist", linear=vector((0.5, 0, 0)), angular=vector((0, 0, 0)))
    with receiving(tmp_path, network, clock) as part:
        receiver = receive.Receiver(part, cameras=False)

        def newest():
            """What is handed on of a simulator whose time is years before this computer's."""
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
        assert set(receiver.reception.vehicle.dropped) <= {f"{topic}: {NO_STAMP}" for topic in ("/cmd_vel", "/steer")}
        receiver.transport.close()


def test_all_that_waits_is_read_at_once(part, network):
    receiver, publish = receive.Receiver(part, cameras=False), network.session().publisher("/odom", ODOMETRY)
    assert until(lambda: publish(odometry(0.0)) or (receiver.read(), part.ring("readings").written)[1])
    before, waiting = part.ring("readings").written, receiver._small
    for row in range(1, 6):
        publish(odometry(row / 50))
    assert until(lambda: len(waiting) >= 5)
    receiver.read()
    assert not waiting
    assert part.ring("readings").written >= before + 5
    receiver.transport.close()


def test_a_course_that_is_published_once_outlives_a_spike_at_the_start(tmp_path, network):
    write_rig(tmp_path)
    robot = network.session(patient=True)
    with receiving(tmp_path, network, request=CourseRequest(topic="/course")) as part:
        receiver, odom = receive.Receiver(part, cameras=False), robot.publisher("/odom", ODOMETRY)
        assert until(lambda: odom(odometry(0.0)) or len(receiver._small))
        robot.publisher("/course", "nav_msgs/msg/Path", keep=True)(path("map"))
        assert until(lambda: "/course" in receiver._small._waiting)
        for row in range(1000):
            odom(odometry(row / 50))
        assert until(lambda: part.dropped.total() > 500), part.dropped
        receiver.read()
        assert part.ring("course").written == 1, part.dropped
        assert list(part.dropped) == ["/odom: comes faster than it is decoded"]
        receiver.transport.close()
