"""The doctor names each fault of a robot, and finds none in a correct one."""

import math
import re
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from live.synthetic_robot import ACKERMANN, ENABLE, ODOMETRY, START, Robot, write_rig
from offpiste.live import doctor
from offpiste.live.doctor import examined
from offpiste.logs.ros.writer import make
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import Network

LISTENS = 1.2
"""Time to listen [s]: more than a busy machine needs for the first message."""


def same(given):
    return given


def found(folder, more="", *, run="", change=same, odom=same, before=same, late=0.0, **robot):
    """Findings about a robot that publishes, with given faults of its messages and of its rig."""
    file, stop = Path(write_rig(folder, more)), threading.Event()
    file.write_text(change(file.read_text()))
    with closing(Network()) as network:
        publishes = Robot(network.session(), scans=1, scan_age=0.0, **robot)

        def publish():
            while not stop.wait(0.05):
                publishes.publish(time.time() - START / 1e9 - late, change=odom)

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            before(network)
            return list(examined(str(file), run, None, ZenohSettings(endpoint=network.endpoint), LISTENS, "system"))
        finally:
            stop.set()
            thread.join()


def errors(findings):
    return [what for level, what in findings if level == "error"]


def test_a_correct_robot_has_no_errors(tmp_path):
    findings = found(tmp_path, more='[channels.gear]\ntopic = "/gear"\nfields = ["data"]\n', before=commands)
    assert errors(findings) == []
    said = [what for _, what in findings]
    assert re.search(r"offpiste \S+, eclipse-zenoh \S+, rosbags \S+, torch \S+, Python 3", said[0])
    assert any(what.startswith(f"/odom: {ODOMETRY}") and "a second" in what for what in said)
    assert "/drive: ackermann_msgs/msg/AckermannDriveStamped can be sent" in said
    assert ("warning", "/gear: nothing heard") in findings, "an optional channel"
    assert any("another publisher commands" in what for what in said)


@pytest.mark.parametrize(
    ("timeouts", "late", "named"),
    [
        ("state = 0.4\nscan = 0.1\nscan_limit = 0.1", 0.0, {"/points": "scan and live.timeouts.scan_limit"}),
        ("state = 0.2", 0.15, {"/odom": "state"}),
        ("state = 0.8\nscan = 1.0\nscan_limit = 2.0", 0.35, {}),
    ],
)
def test_timeouts_below_the_age_after_a_lost_message_are_named(tmp_path, timeouts, late, named):
    """Messages are 0.05 s apart: after a lost one, the newest is 0.1 s old, or more if it is late."""
    findings = found(tmp_path, more=f"[live.timeouts]\n{timeouts}\n", late=late)
    said = {what.split(":")[0]: what for level, what in findings if level == "warning" and "live.timeouts" in what}
    assert said.keys() == named.keys()
    assert all(said[topic].endswith(f"increase live.timeouts.{what}") for topic, what in named.items())
    assert not any(what.startswith("/odom") for what in errors(findings))


def soon(publish, *arguments):
    threading.Timer(0.3, publish, arguments).start()


def other_hash(network):
    soon(network.router._session.put, "0/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_1", b"")


def commands(network):
    soon(network.session().publisher("/drive", ACKERMANN), network.router.types.empty(ACKERMANN))


def presses(network):
    soon(network.session().publisher("/enable", "std_msgs/msg/Bool"), make("std_msgs/Bool", data=True))


def publishes_text(network):
    soon(network.session().publisher("/points", "std_msgs/msg/String"), make("std_msgs/String", data="no scan"))


def spoiled(message):
    message.pose.pose.position.x = np.nan
    return message


FAULTS = {
    "topics": (
        {"odom_topic": "/odometry", "without": ("/points",), "more": ENABLE},
        (r"/odom: nothing heard; did you mean '/odometry'\?", "/points: nothing heard", "/enable: nothing heard"),
    ),
    "clocks, transforms and the model": (
        {"late": 5.0, "without": ("/tf_static",), "run": "pretrained:proving-ground/parametric"},
        ("synchronise the clocks", "no fixed transform joins", "reads brake, .* does not have"),
    ),
    "fields": (
        {
            "change": lambda text: text.replace("twist.twist.linear.x", "twist.linear.x"),
            "odom": spoiled, "more": ENABLE + 'field = "seq"\n', "before": presses,
        },
        ("linear_velocity: .*linear", "position: not finite", "/enable: std_msgs/msg/Bool has no number 'seq'"),
    ),
    "types": (
        {"more": '[live.types]\n"/odom" = "geometry_msgs/msg/PoseStamped"\n', "before": publishes_text},
        ("/odom: of type nav_msgs", "lidar: .*String"),
    ),
    "unknown types and another hash": (
        {
            "more": '[live.types]\n"/points" = "my_msgs/msg/Cloud"\n', "before": other_hash,
            "change": lambda text: text.replace("ackermann_msgs", "my_msgs"),
        },
        ("my_msgs/msg/Cloud is unknown", "my_msgs/msg/Ackermann.* is unknown", "its hash differs"),
    ),
    "an invalid rig": ({"change": lambda text: text + "["}, ("not valid TOML",)),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTS)
def test_each_fault_is_named(tmp_path, case):
    options, expected = FAULTS[case]
    said = errors(found(tmp_path, **options))
    for what in expected:
        assert any(re.search(what, line) for line in said), (what, said)


def test_ages_do_not_count_if_the_rig_uses_arrival_times(tmp_path):
    assert errors(found(tmp_path, late=5.0, more='[clock]\nstamps = "receive"\n')) == []


def test_headers_without_a_stamp_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "heard_at", lambda *given: math.nan)
    said = errors(found(tmp_path))
    assert any("/odom: nav_msgs/msg/Odometry, " in what and "its header has no stamp" in what for what in said)
