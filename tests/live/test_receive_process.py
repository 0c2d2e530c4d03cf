"""The process that receives: it does not wait for ever on a connection whose thread has ended."""

import time
from itertools import count

import pytest

from live.made_up_robot import cloud, odometry, small_settings, tree, write_course, write_rig
from live.test_supervisor import RUN
from offpiste.errors import LiveError
from offpiste.live.backlog import Backlog
from offpiste.live.part import Part
from offpiste.live.parts import receive
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, new_session
from offpiste.planning.course import Course
from offpiste.transport.interface import Received
from offpiste.transport.tally import Tally
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import network, until

__all__ = ["network"]


@pytest.fixture
def part(tmp_path, network):
    robot = ZenohSettings(endpoint=network.endpoint)
    request = CourseRequest(write_course(tmp_path))
    with new_session(LiveSettings(write_rig(tmp_path), RUN, None, request, small_settings(), robot)) as session:
        yield Part("receive", session)


def test_where_nothing_is_heard_any_more_it_ends_and_is_started_again(part, network, monkeypatch):
    monkeypatch.setattr(receive, "DEAF", 0.3)
    receiver = receive.Receiver(part, cameras=False)
    publish = network.session().publisher("/odom", "nav_msgs/msg/Odometry")
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
    odom = robot.publisher("/odom", "nav_msgs/msg/Odometry")
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


def test_the_oldest_give_way_and_are_counted():
    dropped = Tally()
    backlog = Backlog(2, dropped)
    for number in range(5):
        backlog.put(Received("/a", "", b"", 0.0, number))
    assert [backlog.get(0.0).sequence, backlog.get(0.0).sequence] == [3, 4]
    assert backlog.get(0.01) is None
    assert dropped == {"/a: comes faster than it is decoded": 3}
