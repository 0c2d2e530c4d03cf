"""Logs with several clocks, or several senders on one topic: each is named for what it is, and spoils no numbers."""

from functools import cache

import numpy as np
import pytest
from simulated import RIG, START, drive_log

from bag_files import converted
from offpiste.core.errors import LogError
from offpiste.dataset.log_findings import UnusableLog, refuse_unusable
from offpiste.inspection.extract import findings_on
from offpiste.inspection.inspect import inspect_log
from offpiste.logs import open_log
from offpiste.logs.ros.writer import McapWriter, header, make, vector
from offpiste.logs.sensor_log import open_sensors
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import parse_rig
from sensor_bags import cloud, odometry_of, record, sensor_rig, transforms

POSE = {
    "position": [f"pose.pose.position.{axis}" for axis in "xyz"],
    "orientation": [f"pose.pose.orientation.{axis}" for axis in "xyzw"],
    "linear_velocity": [f"twist.twist.linear.{axis}" for axis in "xyz"],
    "angular_velocity": [f"twist.twist.angular.{axis}" for axis in "xyz"],
}
RECEIVE, SORT = (Edit("clock.stamps", "receive"),), (Edit("clock.sort", True),)
ORIGINS = "uses another clock than /odom: their origins differ"
STEP = "all clocks step back by 1.50 s"
ALTERNATE = "has several senders: its values alternate between two series"


def rig(frame):
    text = RIG.split("[channels")[0].replace("absent = [", 'absent = ["steer_angle", ')
    for name, fields in POSE.items():
        body = 'frame = "body"\n' if "velocity" in name else ""
        text += f'[channels.{name}]\ntopic = "/odom"\nfields = {fields}\n{body}'
    for name, axis in zip(("throttle", "brake", "steer"), "xyz", strict=True):
        text += f'[channels.{name}]\ntopic = "/command"\nfields = ["{"vector." * bool(frame)}{axis}"]\n'
    return parse_rig(text, where="test")


def odometry(stamp, row, child):
    return odometry_of(header(round(stamp * 1e9), "odom"), row[:3], row[3:7], row[7:10], row[10:13], child)


def command(stamp, values, frame):
    headed = {"header": header(round(stamp * 1e9), frame), "vector": vector(values)} if frame else {}
    return make("geometry_msgs/Vector3Stamped", **headed) if frame else vector(values)


@cache
def driven():
    data = drive_log(seconds=40.0).data
    (time, odom), (stamps, pedals), (steering, angles) = data["odom"], data["pedals"], data["steering"]
    steer = np.interp(stamps, steering, angles["command"])
    return time, np.stack(list(odom.values()), axis=1), stamps, np.stack((*pedals.values(), steer), axis=1)


def same(time):
    return time


def write(path, pose=same, command_clock=same, recorder=same, frame="joy", second_pose="", second_command=None):
    """A recording of 40 s; clocks are functions of the true time, second senders take turns with the first ones."""
    time, rows, stamps, values = driven()
    sent = [(t + 0.01, "/odom", odometry(pose(t), row, "base_link")) for t, row in zip(time, rows, strict=True)]
    sent += [(t + 4e-3, "/command", command(command_clock(t), v, frame)) for t, v in zip(stamps, values, strict=True)]
    aside = rows[::2] + np.eye(rows.shape[1])[0]
    others = zip(time[::2] + 0.006, aside, strict=True) if second_pose else ()
    sent += [(t + 0.012, "/odom", odometry(pose(t), row, second_pose)) for t, row in others]
    others = stamps + 0.007 if second_command is not None else ()
    sent += [(t + 4e-3, "/command", command(command_clock(t), (0, 0, 0), second_command)) for t in others]
    arrived = [(round(recorder(t) * 1e9), topic, message) for t, topic, message in sorted(sent, key=lambda one: one[0])]
    log = path.with_suffix(".mcap")
    with McapWriter(log) as writer:
        for t, topic, message in arrived:
            writer.write(topic, message, t)
    return log if path == log else converted(log, path)


def back(time):
    return time - 1.5 * (time > START + 20)


def simulated(time):
    return time - START + 12.0


def at(rate):
    return lambda time: START + rate * (time - START)


CASES = {
    "healthy": ({}, None, ()),
    "healthy, without headers": ({"frame": ""}, None, ()),
    "wall clock beside simulated time": ({"pose": simulated}, ORIGINS, RECEIVE),
    "the same without headers": ({"pose": simulated, "frame": ""}, ORIGINS, RECEIVE),
    "slow simulation": ({"pose": lambda t: 0.9 * simulated(t), "frame": ""}, ORIGINS, ()),
    "all clocks step": ({"pose": back, "command_clock": back, "recorder": back}, STEP, ()),
    "all but commands have headers, and all step": ({"pose": back, "recorder": back, "frame": ""}, STEP, ()),
    "headers step": ({"pose": back, "command_clock": back}, STEP, RECEIVE),
    "recorder steps": ({"recorder": back}, "stamps go back", SORT),
    "fast commands": ({"command_clock": at(1.01)}, "its clock runs 1.00% faster than that of /odom", RECEIVE),
    "fast pose": ({"pose": at(1.008)}, "its clock runs 0.79% slower than that of /odom", RECEIVE),
    "two poses": ({"second_pose": "lidar_odom"}, ALTERNATE, ()),
    "two commanders": ({"second_command": "nav"}, ALTERNATE, ()),
    "the same of no frame": ({"frame": "", "second_command": ""}, ALTERNATE, ()),
}


ROS1_CASES = ("healthy", "headers step", "two poses")


@pytest.mark.parametrize(("case", "ending"), [(c, "mcap") for c in CASES] + [(c, "bag") for c in ROS1_CASES])
def test_faults_of_clocks_and_senders(tmp_path, case, ending):
    faults, what, cure = CASES[case]
    path, of = write(tmp_path / f"drive.{ending}", **faults), rig(faults.get("frame", "joy"))
    found = inspect_log(open_log(path), of)
    if what is None:
        assert found.findings == ()
        assert [f for f in inspect_log(open_log(path)).findings if f.severity != "note"] == []
        return
    assert found.findings[0].what == what
    assert not [f for f in found.findings if "missing" in f.what or "jumps" in f.what]
    if what != "stamps go back":
        with pytest.raises(UnusableLog, match=r"\A[^\n]*\Z"):
            refuse_unusable(findings_on(open_log(path), of), path)
        assert what in {f.what for f in inspect_log(open_log(path)).findings}  # without a rig
    if cure:
        assert found.cure == cure
        assert inspect_log(open_log(path), edited(of, cure)).findings == ()


def test_two_lidars_on_one_topic_are_not_mixed(tmp_path):
    messages = [(0, "/tf_static", transforms(*(("base_link", side, (0, 0, 2), (0, 0, 0, 1)) for side in "lr")))]
    for k in range(20):
        messages.append((0.05 * k, "/points", cloud(0.05 * k)))
        messages[-1][2].header.frame_id = "lr"[k % 2]
    log, lidar = open_log(record(tmp_path / "drive.mcap", messages)), '[lidars.top]\ntopic = "/points"\n'
    with pytest.raises(LogError, match="'/points' has several senders, of frames 'l', 'r'; give each"):
        open_sensors(log, sensor_rig(lidar))
    sensors = open_sensors(log, sensor_rig(lidar + 'frame = "l"\n'))
    with pytest.raises(LogError, match=r"'top': its topic has several senders, of frames 'l' and 'r'; give each"):
        list(sensors.stream())
    for k, message in enumerate(messages[1:]):  # a driver that restarts with another frame
        message[2].header.frame_id = "lr"[k >= 10]
    restarted = open_sensors(
        open_log(record(tmp_path / "restarted.mcap", messages)), sensor_rig(lidar + 'frame = "l"\n')
    )
    assert len(list(restarted.stream())) == 20


def test_quaternions_of_random_signs_have_one_sender():
    log = drive_log(seconds=40.0)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], len(log.data["odom"][0]))
    for field in ("qx", "qy", "qz", "qw"):
        log = log.change("odom", field, lambda values: values * signs)
    assert ALTERNATE not in {finding.what for finding in inspect_log(log, parse_rig(RIG, where="test")).findings}
