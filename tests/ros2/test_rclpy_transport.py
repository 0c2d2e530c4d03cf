"""The example transport by rclpy, with a substitute for rclpy."""

import configparser
import pickle
import queue
import runpy
import sys
import threading
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from live.synthetic_robot import START, odometry, planner, rig, small_settings, write_course, write_rig
from offpiste.core.errors import MissingExtra, TransportError
from offpiste.live.lockstep import Lockstep, StepDriver
from offpiste.live.play import clock_message
from offpiste.live.reception import CourseRequest, Reception
from offpiste.logs.ros.writer import make
from offpiste.transport.interface import RobotSettings, Transport
from ros2.fake_rclpy import DurabilityPolicy, Graph, ReliabilityPolicy
from transport.routers import until

PACKAGE = Path(__file__).parents[2] / "ros2" / "offpiste_ros"
STRING = "std_msgs/msg/String"


@pytest.fixture
def graph(monkeypatch):
    monkeypatch.syspath_prepend(str(PACKAGE))
    return Graph().install(monkeypatch)


@pytest.fixture
def connect(graph):
    """Open connections; those with equal `run` belong to one drive."""
    from offpiste_ros.rclpy_transport import RclpySettings

    made = []

    def connected(run="offpiste_aaaaaaaa", definitions=()):
        made.append(RclpySettings(run).connect(definitions))
        return made[-1]

    yield connected
    for transport in made:
        transport.close()


def text(data="hello"):
    return make("std_msgs/String", data=data)


def test_it_is_a_transport_whose_settings_can_be_pickled(connect, graph):
    from offpiste_ros.rclpy_transport import RclpySettings

    settings = RclpySettings()
    assert isinstance(settings, RobotSettings)
    assert pickle.loads(pickle.dumps(settings)) == settings  # noqa: S301 - our own
    assert RclpySettings() != settings, "each drive has settings of its own"
    transport = connect()
    assert isinstance(transport, Transport)
    assert transport.routers() == 1
    assert [option.name for option in graph.signals] == ["NO"], "offpiste handles Ctrl-C"


def test_messages_arrive_with_the_identity_of_their_drive(connect):
    ours, beside, robot = connect(), connect(), connect("robot")
    heard, from_us = queue.SimpleQueue(), queue.SimpleQueue()
    ours.subscribe("/odom", heard.put, msgtype="nav_msgs/msg/Odometry")
    ours.subscribe("/drive", from_us.put, msgtype=STRING)
    robot.publisher("/odom", "nav_msgs/msg/Odometry")(odometry(1.0, 5.0))
    received = heard.get(timeout=5)
    assert ours.decode(received).pose.pose.position.x == 5.0
    assert received.publisher == b""
    command = beside.publisher("/drive", STRING)
    command(text())
    assert from_us.get(timeout=5).publisher[:8] == ours.identity == beside.identity
    assert ours.topics() == {"/odom": "nav_msgs/msg/Odometry"}, "published by others"
    robot.publisher("/drive", STRING)
    assert until(lambda: command(text()) or from_us.get(timeout=5).publisher[:8] != ours.identity), "or another's"
    first, second = (command(text()) or from_us.get(timeout=5).publisher for _ in range(2))
    assert first != second, "of several publishers"


def test_a_message_of_an_unknown_publisher_counts_as_anothers(connect, graph):
    ours, robot, heard = connect(), connect("robot"), []
    publish = robot.publisher("/drive", STRING)
    ours.subscribe("/drive", heard.append, msgtype=STRING)
    hidden = graph.publishers.pop()
    assert until(lambda: ours._names == {"/drive": []})
    hidden.publish(bytes(8))
    assert heard[-1].publisher == b""
    assert publish is not None


def test_a_publisher_is_subscribed_to_once(connect, graph, monkeypatch):
    ours, robot, heard = connect(), connect("robot"), []
    robot.publisher("/points", STRING)
    answers, asked = iter([[]]), ours._publishers
    monkeypatch.setattr(ours, "_publishers", lambda topic: next(answers, asked(topic)))
    ours.subscribe("/points", heard.append)
    assert until(lambda: graph.subscriptions)
    assert not until(lambda: len(graph.subscriptions) > 1, 0.2)


def test_an_unknown_type_does_not_end_the_nodes_thread(connect, graph, monkeypatch):
    from offpiste_ros import rclpy_transport

    ours, robot, heard, known = connect(), connect("robot"), [], rclpy_transport._class_of

    def class_of(msgtype):
        if msgtype == "std_msgs/msg/Float64":
            raise TransportError("ROS does not know it")
        return known(msgtype)

    robot.publisher("/number", "std_msgs/msg/Float64")
    monkeypatch.setattr(rclpy_transport, "_class_of", class_of)
    ours.subscribe("/number", heard.append)
    assert until(lambda: list(ours.refused) == ["/number: ROS does not know it"])
    ours.subscribe("/text", heard.append)
    publish = robot.publisher("/text", STRING)
    assert until(lambda: publish(text()) or heard)


def test_types_and_latched_messages_of_later_publishers(connect, graph):
    ours, robot, heard = connect(), connect("robot"), []
    ours.subscribe("/tf_static", heard.append, history=True)
    ours.subscribe("/points", heard.append)
    assert not graph.subscriptions
    robot.publisher("/tf_static", STRING, keep=True)(text("kept"))
    assert until(lambda: len(heard) == 1)
    assert (heard[0].topic, heard[0].type, ours.decode(heard[0]).data) == ("/tf_static", STRING, "kept")
    robot.publisher("/points", STRING)
    assert until(lambda: len(graph.subscriptions) == 2)
    kept, live = graph.subscriptions
    assert kept.quality.durability == DurabilityPolicy.BEST_AVAILABLE
    assert live.quality.reliability == ReliabilityPolicy.BEST_EFFORT, "hears reliable publishers and others"


def test_unchecked_messages_arrive_without_their_data(connect):
    ours, robot, heard = connect(), connect("robot"), []
    ours.subscribe("/drive", heard.append, unchecked=True)
    command = robot.publisher("/drive", STRING)
    assert until(lambda: command(text()) or heard)
    assert (heard[0].topic, heard[0].type, heard[0].data, heard[0].publisher) == ("/drive", "", b"", b"")


def test_invalid_messages_are_refused_and_counted(connect, graph, monkeypatch):
    from offpiste_ros import rclpy_transport

    ours, robot, heard = connect(), connect("robot"), []
    ours.subscribe("/text", heard.append, msgtype=STRING)
    robot.publisher("/text", STRING)
    damaged, large = graph.publishers[-1], b"\0\1\0\0" + bytes(100)
    damaged.publish(b"\0\1\0\0\xff\xff\xff\xff")
    assert ours.decode(heard[0]) is None
    monkeypatch.setattr(rclpy_transport, "LARGEST", 50)
    damaged.publish(large)
    assert len(heard) == 1
    graph.nodes[-1].create_publisher(type("Odd", (), {"NAME": "odd_msgs/msg/Odd"}), "/odd", damaged.quality)
    ours.subscribe("/odd", heard.append)
    assert until(lambda: len(ours.refused) == 3)
    reasons = {"/text: cannot be decoded": 1, "/text: too large": 1, "/odd: unknown type odd_msgs/msg/Odd": 1}
    assert dict(ours.refused) == reasons
    with pytest.raises(TransportError, match="is unknown"):
        ours.publisher("/x", "odd_msgs/msg/Odd")


def test_a_missing_package_and_a_missing_ros_are_named(connect, tmp_path, monkeypatch):
    file = tmp_path / "unbuilt_msgs" / "msg" / "Some.msg"
    file.parent.mkdir(parents=True)
    file.write_text("float64 value\n")
    with pytest.raises(TransportError, match=r"apt install ros-.*-unbuilt-msgs"):
        connect(definitions=(file,)).publisher("/x", "unbuilt_msgs/msg/Some")
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(MissingExtra, match="source ROS"):
        connect()


def test_a_lockstep_runs_over_it(connect, tmp_path):
    ours, robot, answers = connect(), connect("robot"), queue.SimpleQueue()
    made_up = rig()
    reception = Reception(made_up, CourseRequest(write_course(tmp_path)), cameras=False)
    driver = StepDriver(made_up, planner(), reception, small_settings())
    session = Lockstep(ours, driver, reception, None)
    ready = queue.SimpleQueue()
    robot.subscribe("/offpiste/ready", ready.put, history=True)
    assert robot.decode(ready.get(timeout=5)).data == "ready"
    robot.subscribe("/offpiste/command", answers.put, msgtype="sensor_msgs/msg/Joy")
    odom = robot.publisher("/odom", "nav_msgs/msg/Odometry")
    clock = robot.publisher("/clock", "rosgraph_msgs/msg/Clock")
    assert until(lambda: "/odom" not in [wanted[0] for wanted in ours._waiting])
    steps, stop = [], threading.Event()
    thread = threading.Thread(target=session.run, args=(lambda now, step: steps.append((now, step)), stop))
    thread.start()
    for row in range(3):
        odom(odometry(row / 50, row / 10))
        clock(clock_message(START + row * 20_000_000))
        answer = robot.decode(answers.get(timeout=30))
        assert answer.header.stamp.nanosec == row * 20_000_000
    robot.publisher("/offpiste/end", STRING)(text("played"))
    thread.join(10)
    assert [now for now, _ in steps] == pytest.approx([200.0, 200.02, 200.04])
    assert reception.waiting_for.startswith("messages on /points"), "it has read the odometry"
    np.testing.assert_allclose(reception.vehicle._kept["position"][-1][1], (0.2, 0.0, 0.33))


def test_the_node_has_the_arguments_of_offpiste_live(graph, monkeypatch, tmp_path):
    from offpiste_ros import live_node
    from offpiste_ros.rclpy_transport import RclpySettings

    from offpiste.live import commands

    ran = []
    monkeypatch.setattr(commands, "run_live", lambda settings, **more: ran.append((settings, more)))
    course = write_course(tmp_path)
    given = [write_rig(tmp_path), "--course", str(course), "--drive", "--ros-args", "-r", "__ns:=/robot"]
    assert live_node.main(given) == 0
    settings, more = ran[0]
    assert isinstance(settings.robot, RclpySettings)
    assert (settings.drive, settings.course.file) == (True, course)
    assert more == {"lockstep": False, "replay": None, "commands": None}


def test_an_error_is_one_line(graph, capsys, tmp_path):
    from offpiste_ros import live_node

    assert live_node.main([str(tmp_path / "none.toml"), "--goal", "1", "2"]) == 1
    assert capsys.readouterr().err.startswith("offpiste: ")


def test_the_package_is_one_of_ament_python(monkeypatch):
    monkeypatch.chdir(PACKAGE)
    said = {}
    monkeypatch.setattr("setuptools.setup", said.update)
    runpy.run_path("setup.py")
    package = ElementTree.parse("package.xml").getroot()
    assert package.findtext("export/build_type") == "ament_python"
    assert package.findtext("name") == said["name"] == "offpiste_ros"
    assert package.findtext("version") == said["version"]
    module, function = said["entry_points"]["console_scripts"][0].split("= ")[1].split(":")
    assert f"def {function}(" in (PACKAGE / (module.replace(".", "/") + ".py")).read_text()
    options = configparser.ConfigParser()
    options.read("setup.cfg")
    assert options["install"]["install_scripts"] == "$base/lib/offpiste_ros"


def test_who_publishes_is_not_asked_with_each_message(connect, graph, monkeypatch):
    ours, robot, heard = connect(), connect("robot"), []
    publish = robot.publisher("/odom", STRING)
    ours.subscribe("/odom", heard.append, msgtype=STRING)
    asked, who = ours._publishers, []
    monkeypatch.setattr(ours, "_publishers", lambda topic: who.append(threading.current_thread()) or asked(topic))
    publish(text())
    assert len(heard) == 1
    assert threading.current_thread() not in who
