"""Robot without a simulator: it stands, or drives straight ahead on a plain seen by one LiDAR."""

import re
from itertools import count
from pathlib import Path

import numpy as np
import torch

import sensor_bags
from offpiste.live.command_messages import path_message
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings
from offpiste.logs.ros.sensor_messages import message_from_points
from offpiste.logs.ros.writer import McapWriter, header, make
from offpiste.planning import mppi
from offpiste.planning.controls import PEDAL_LIMITS
from offpiste.rig.rig import parse_rig
from offpiste.runtime.backing_out import BackingOutSettings
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.planner import Planner
from offpiste.runtime.prediction import Prediction
from offpiste.transport.zenoh_transport import ZenohSettings
from runtime import stream
from runtime.stream import parametric, settings

RUN = "pretrained:proving-ground/parametric"
ACKERMANN = "ackermann_msgs/msg/AckermannDriveStamped"
ODOMETRY, CLOUD, TRANSFORMS = "nav_msgs/msg/Odometry", "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
START = sensor_bags.stamp(0)
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4")])
RIG = """
name = "synthetic"
absent = ["throttle", "brake", "steer", "brake_pressure", "steer_angle", "steer_rate", "engine_rpm", ]
[vehicle]
mass = 1150.0
max_steer = 0.5
pose_point = "the middle"
wheel_positions = [[1.03, 0.66], [1.03, -0.66], [-1.03, 0.66], [-1.03, -0.66]]
[channels.position]
topic = "/odom"
fields = ["pose.pose.position.x", "pose.pose.position.y", "pose.pose.position.z"]
[channels.orientation]
topic = "/odom"
fields = ["pose.pose.orientation.x", "pose.pose.orientation.y", "pose.pose.orientation.z", "pose.pose.orientation.w"]
[channels.linear_velocity]
topic = "/odom"
frame = "body"
fields = ["twist.twist.linear.x", "twist.twist.linear.y", "twist.twist.linear.z"]
[channels.angular_velocity]
topic = "/odom"
frame = "body"
fields = ["twist.twist.angular.x", "twist.twist.angular.y", "twist.twist.angular.z"]
[lidars.lidar]
topic = "/points"
time_field = "t"
time_unit = "ns"
[outputs.drive]
topic = "/drive"
type = "ackermann_msgs/msg/AckermannDriveStamped"
[outputs.drive.fields]
"drive.acceleration" = { of = "pedal" }
"drive.steering_angle" = { of = "steer", unit = "rad" }
"drive.speed" = { of = "speed" }
"""
EARTH = RIG.replace("[channels.position]\n", '[channels.position]\nunit = "lat lon"\norigin = [48.0, 11.0]\n')
ACTUATORS = """
[channels.brake_pressure]
topic = "/odom"
fields = ["pose.covariance[0]"]
[channels.steer_angle]
topic = "/odom"
fields = ["pose.covariance[1]"]
[channels.engine_rpm]
topic = "/odom"
fields = ["pose.covariance[2]"]
"""
ENABLE = '[live.enable]\ntopic = "/enable"\n'


def rig_text(more=""):
    """The rig with further entries; channels among them are no longer absent, nor is the rate of a steering angle."""
    text, names = RIG, re.findall(r"\[channels\.(\w+)\]", more)
    if "steer_angle" in names:
        names.append("steer_rate")
    for name in names:
        text = text.replace(f'"{name}", ', "", 1)  # the list comes first
    return text + more


def rig(more=""):
    return parse_rig(rig_text(more), where="test")


def write_rig(folder: Path, more="", *, actuators=False) -> str:
    """The rig as a file; with actuators, those that the shipped runs read are measured."""
    file = folder / "rig.toml"
    file.write_text(rig_text(ACTUATORS * actuators + more))
    return str(file)


def write_course(folder: Path, length=60.0, speed=4.0) -> Path:
    file = folder / "course.csv"
    file.write_text("x,y,speed\n" + "".join(f"{x},0,{speed}\n" for x in np.arange(0.0, length)))
    return file


def live_settings(folder: Path, more="", *, network=None, actuators=False, course=None, **changed) -> LiveSettings:
    """Settings of a drive along a straight course; the rig and the course are written to the folder."""
    if network is not None:
        changed["robot"] = ZenohSettings(endpoint=network.endpoint)
    given = {"rig": write_rig(folder, more, actuators=actuators), "run": RUN, "pca": None}
    given |= {"course": course or CourseRequest(write_course(folder)), "runtime": small_settings()}
    return LiveSettings(**given | changed)


def planner():
    return Planner("parametric", Path("nowhere"), parametric())


def small_settings():
    """Settings with which a plan takes a few milliseconds."""
    sampling = mppi.Settings(PEDAL_LIMITS, (0.35, 0.3), samples=32, rest=(0.2, 0.0))
    return settings(sampling=sampling, backing_out=BackingOutSettings(attempts=0))  # it never moves, and is not stuck


def path(frame, stamp=START, end=9.0):
    """A straight nav_msgs/Path."""
    return path_message(np.array(((0.0, 0.0, 0.0), (end, 0.0, 0.0))), np.zeros(2), stamp, frame)


def joy(stamp, *buttons):
    """A sensor_msgs/Joy with these buttons."""
    pressed = np.array(buttons, np.int32)
    return make("sensor_msgs/Joy", header=header(stamp, ""), axes=np.zeros(0, np.float32), buttons=pressed)


def odometry(seconds, x=0.0, speed=0.0):
    return sensor_bags.odometry(seconds, x=x, speed=speed, height=0.33)


def cloud(seconds):
    """A plain, 2 m below the LiDAR; its last point is measured 0.09 s after its stamp."""
    at = np.arange(-20.0, 20.0, 0.4)
    points = np.zeros(len(at) ** 2, POINT)
    points["x"], points["y"] = (axis.ravel() for axis in np.meshgrid(at, at))
    points["z"], points["t"] = -2.33, np.linspace(0, 9e7, len(points)).astype(np.uint32)
    return message_from_points(points, START + round(seconds * 1e9), "lidar")


def tree():
    return sensor_bags.transforms(("base_link", "lidar", (0, 0, 2), (0, 0, 0, 1)))


class Robot:
    """Robot that publishes odometry, and a scan with every `scans`-th odometry message."""

    def __init__(self, session, *, odom_topic="/odom", without=(), scans=5, scan_age=0.1):
        self.odom, self.rows = session.publisher(odom_topic, ODOMETRY), count()
        self.scans, self.scan_age = scans, scan_age
        self.points = None if "/points" in without else session.publisher("/points", CLOUD)
        if "/tf_static" not in without:
            session.publisher("/tf_static", TRANSFORMS, keep=True)(tree())

    def publish(self, seconds, x=0.0, speed=0.0, change=lambda message: message):
        self.odom(change(odometry(seconds, x, speed)))
        if next(self.rows) % self.scans == 0 and self.points is not None:
            self.points(cloud(seconds - self.scan_age))


def reading(now, x=0.0, speed=0.0):
    return stream.reading(now, x, vx=speed, actuators=0.0)


def plan(start, speed=2.0, gear=1.0):
    """A plan made 0.1 s before its start that leads straight ahead from x = 1 m."""
    states = np.zeros((250, 6))
    states[:, 0], states[:, 3] = 1.0 + speed * 0.02 * np.arange(1, 251), speed
    controls = torch.tensor([[0.4, 0.0, 0.2]]).repeat(250, 1)
    return TimedPlan(start, start - 0.1, controls, Prediction(start, states), gear)


def write_log(path: Path, seconds=3.0, speed=2.0):
    """A log of a drive straight ahead; clouds carry the stamp of their first point."""
    with McapWriter(path) as writer:
        writer.write("/tf_static", tree(), START)
        for row in range(round(seconds * 50)):
            time = row / 50
            stamp = START + round(time * 1e9)
            writer.write("/odom", odometry(time, speed * time, speed), stamp)
            if row % 5 == 0:
                writer.write("/points", cloud(time), stamp)
    return path
