"""The doctor names each of ten wrong set-ups, and has no complaint about a right one."""

import re
import threading
import time

import numpy as np
import pytest

from live.made_up_robot import ENABLE, START, cloud, odometry, tree, write_rig
from offpiste.live.doctor import examined
from offpiste.logs.ros.writer import make
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import Network, free_port

ODOM = "nav_msgs/msg/Odometry"


LISTENS = 1.5
"""Time that a busy machine takes at most to bring the first message [s]."""


class Robot:
    """Publishes until it is closed; what is wrong with it is given."""

    def __init__(self, network, *, late=0.0, without=(), odom=lambda message: message, odom_topic="/odom"):
        session = network.session()
        self._stop = threading.Event()
        publish = session.publisher(odom_topic, ODOM)
        scan = session.publisher("/points", "sensor_msgs/msg/PointCloud2")
        if "/tf_static" not in without:
            session.publisher("/tf_static", "tf2_msgs/msg/TFMessage", keep=True)(tree())

        def run():
            while not self._stop.wait(0.05):
                now = time.time() - START / 1e9 - late
                publish(odom(odometry(now)))
                if "/points" not in without:
                    scan(cloud(now))

        self._thread = threading.Thread(target=run)
        self._thread.start()

    def close(self):
        self._stop.set()
        self._thread.join()


def found(folder, *, more="", run="", change=lambda text: text, before=lambda network: None, **robot):
    network = Network()
    rig = write_rig(folder, more)
    text = change((folder / "rig.toml").read_text())
    (folder / "rig.toml").write_text(text)
    moving = Robot(network, **robot)
    try:
        before(network)
        return list(examined(rig, run, None, ZenohSettings(endpoint=network.endpoint), LISTENS, "system"))
    finally:
        moving.close()
        network.close()


def errors(findings):
    return [what for level, what in findings if level == "error"]


def test_a_robot_that_is_right(tmp_path):
    findings = found(tmp_path)
    assert errors(findings) == []
    said = [what for _, what in findings]
    assert any(what.startswith(f"/odom: {ODOM}") and "a second" in what for what in said)
    assert "/drive: ackermann_msgs/msg/AckermannDriveStamped can be sent" in said


def test_a_gear_that_is_not_heard_is_no_error(tmp_path):
    findings = found(tmp_path, more='[channels.gear]\ntopic = "/gear"\nfields = ["data"]\n')
    assert errors(findings) == []
    assert ("warning", "/gear: nothing heard") in findings


@pytest.mark.parametrize(
    ("timeouts", "late", "named"),
    [
        ("state = 0.4\nscan = 0.5", 0.0, {}),
        ("state = 0.4\nscan = 0.15", 0.0, {"/points": "let live.timeouts.scan be more"}),
        ("state = 0.4\nscan = 0.1\nscan_limit = 0.1", 0.0, {"/points": "scan and live.timeouts.scan_limit be more"}),
        ("state = 0.2", 0.15, {"/odom": "let live.timeouts.state be more"}),
        ("state = 0.8\nscan = 1.0\nscan_limit = 2.0", 0.35, {}),
    ],
)
def test_timeouts_that_are_too_short_for_what_is_heard(tmp_path, timeouts, late, named):
    """The robot's messages are 0.05 s apart, so where one is lost, the last is 0.1 s old, or more if it comes late."""
    findings = found(tmp_path, more=f"[live.timeouts]\n{timeouts}\n", late=late)
    said = {what.split(":")[0]: what for level, what in findings if level == "warning" and "live.timeouts" in what}
    assert said.keys() == named.keys()
    assert all(what in said[topic] for topic, what in named.items())
    assert not any(what.startswith("/odom") for what in errors(findings))


def other_hash(network):
    network.router._session.put("0/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_1", b"")


def commands(network):
    publish = network.session().publisher("/drive", "ackermann_msgs/msg/AckermannDriveStamped")
    made = network.router.types.empty("ackermann_msgs/msg/AckermannDriveStamped")
    threading.Timer(0.3, lambda: publish(made)).start()


def presses(network):
    publish = network.session().publisher("/enable", "std_msgs/msg/Bool")
    threading.Timer(0.3, lambda: publish(make("std_msgs/Bool", data=True))).start()


def spoiled(message):
    message.pose.pose.position.x = np.nan
    return message


def replaced(old, new):
    return {"change": lambda text: text.replace(old, new)}


WRONG = {
    "misspelt topic": ({"odom_topic": "/odometry"}, r"/odom: nothing heard; did you mean '/odometry'\?"),
    "silent LiDAR": ({"without": ("/points",)}, r"/points: nothing heard"),
    "no transforms": ({"without": ("/tf_static",)}, r"no fixed transform joins"),
    "clocks apart": ({"late": 5.0}, r"synchronise the clocks"),
    "another field": (replaced("twist.twist.linear.x", "twist.linear.x"), r"linear_velocity: .*linear"),
    "another type": ({"more": '[live.types]\n"/odom" = "geometry_msgs/msg/PoseStamped"\n'}, r"/odom: of type nav_msgs"),
    "numbers that are none": ({"odom": spoiled}, r"position: not finite or not valid"),
    "a switch without its field": (
        {"more": ENABLE + 'field = "seq"\n', "before": presses},
        r"/enable: std_msgs/msg/Bool has no number 'seq'",
    ),
    "unknown type of a topic": ({"more": '[live.types]\n"/odom" = "my_msgs/msg/Odom"\n'}, r"my_msgs.* is not known"),
    "silent switch": ({"more": ENABLE}, r"/enable: nothing heard"),
    "unknown type of a command": (replaced("ackermann_msgs", "my_msgs"), r"my_msgs.* is not known"),
    "a model that reads more": ({"run": "pretrained:proving-ground/parametric"}, r"reads brake, .* does not have"),
    "another hash": ({"before": lambda n: threading.Timer(0.3, other_hash, [n]).start()}, r"its hash differs"),
    "a rig that is none": ({"change": lambda t: t + "["}, r"not valid TOML"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_named(tmp_path, case):
    options, what = WRONG[case]
    said = errors(found(tmp_path, **options))
    assert any(re.search(what, line) for line in said), said


def test_what_is_wrong_with_the_outputs_does_not_hide_the_rest(tmp_path):
    more = '[live.types]\n"/drive" = "my_msgs/msg/Drive"\n'
    unknown = lambda text: text.replace("ackermann_msgs/msg/AckermannDriveStamped", "my_msgs/msg/Drive")  # noqa: E731
    findings = found(tmp_path, more=more, change=unknown)
    assert len(errors(findings)) == 2, "of the type, and of the output"
    assert any(what.startswith(f"/odom: {ODOM}") for _, what in findings)


def test_ages_count_by_stamps_only_where_the_rig_has_them_count(tmp_path):
    assert errors(found(tmp_path, late=5.0, more='[clock]\nstamps = "receive"\n')) == []


def test_versions_are_said(tmp_path):
    assert re.search(r"offpiste \S+, eclipse-zenoh \S+, rosbags \S+, torch \S+, Python 3", found(tmp_path)[0].what)


def test_others_who_command_are_named(tmp_path):
    assert any("someone else commands" in what for _, what in found(tmp_path, before=commands))


def test_without_a_router_it_says_so(tmp_path):
    robot = ZenohSettings(endpoint=f"tcp/127.0.0.1:{free_port()}")
    findings = list(examined(write_rig(tmp_path), "", None, robot, 0.1, "system"))
    assert "no connection" in errors(findings)[-1]
