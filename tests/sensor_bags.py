"""Small recordings of one camera and one LiDAR on a vehicle that drives straight ahead."""

from pathlib import Path

import cv2
import numpy as np

from factories import WITHOUT_COMMANDS
from offpiste.logs import open_log
from offpiste.logs.ros.sensor_messages import message_from_points
from offpiste.logs.ros.writer import McapWriter, floats, header, make, quaternion, vector
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.rig.rig import Rig, parse_rig

SECOND = 10**9
SPEED = 2.0
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4")])
POINTS = ((5.0, 0.0, 0.0), (0.0, 6.0, 0.0), (0.0, 0.0, 7.0))
SENSORS = """
[cameras.front]
topic = "/image"
info = "/info"
[lidars.top]
topic = "/points"
time_field = "t"
time_unit = "ns"
"""


def sensor_rig(sensors: str = SENSORS) -> Rig:
    """Return a rig with /odom and these sensors."""
    return parse_rig(sensor_rig_text(sensors), where="test")


def sensor_rig_text(sensors: str = SENSORS) -> str:
    """Return the text of `sensor_rig`."""
    text = WITHOUT_COMMANDS
    for name, axes in (("position", "xyz"), ("orientation", "xyzw")):
        fields = ", ".join(f'"pose.pose.{name}.{axis}"' for axis in axes)
        text += f'[channels.{name}]\ntopic = "/odom"\nfields = [{fields}]\n'
    return text + sensors


def odometry(seconds: float, aside: float = 0.0, *, x: float | None = None, speed: float = SPEED, height: float = 1.0):
    """Return odometry of a drive along x, by default from the origin."""
    place = speed * seconds if x is None else x, aside, height
    return odometry_of(header(stamp(seconds), "map"), place, (0, 0, 0, 1), (speed, 0, 0))


def odometry_of(head, place, turn, linear=(0, 0, 0), angular=(0, 0, 0), child: str = "base_link"):
    """Return odometry with a header, a position, a quaternion, and velocities."""
    pose = make("geometry_msgs/Pose", position=vector(place, "geometry_msgs/Point"), orientation=quaternion(turn))
    return make(
        "nav_msgs/Odometry",
        header=head,
        child_frame_id=child,
        pose=make("geometry_msgs/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=make("geometry_msgs/TwistWithCovariance", twist=twist_of(linear, angular), covariance=np.zeros(36)),
    )


def twist_of(linear, angular):
    """Return a geometry_msgs/Twist."""
    return make("geometry_msgs/Twist", linear=vector(linear), angular=vector(angular))


def stamp(seconds: float) -> int:
    """Return a stamp from 100 s on [ns]."""
    return 100 * SECOND + round(seconds * SECOND)


def transforms(*joints, seconds: float = 0.0):
    """Return a tf2_msgs/TFMessage of (parent, child, translation, xyzw)."""
    stamped = []
    for parent, child, t, q in joints:
        transform = make("geometry_msgs/Transform", translation=vector(t), rotation=quaternion(q))
        fields = {"header": header(stamp(seconds), parent), "child_frame_id": child, "transform": transform}
        stamped.append(make("geometry_msgs/TransformStamped", **fields))
    return make("tf2_msgs/TFMessage", transforms=stamped)


def joints(seconds: float, positions, names=("a", "b")):
    """Return a sensor_msgs/JointState of positions."""
    values = {"position": floats(positions), "velocity": floats([]), "effort": floats([])}
    return make("sensor_msgs/JointState", header=header(stamp(seconds), "base"), name=list(names), **values)


def tree():
    """Return transforms to a mast with both sensors; the camera's is inverted."""
    return transforms(
        ("base_link", "mast", (1, 0, 2), (0, 0, 0, 1)),
        ("mast", "lidar", (0, 0, 0.5), (0, 0, np.sqrt(0.5), np.sqrt(0.5))),
        ("camera", "mast", (0, 0, 0.25), (0.5, -0.5, 0.5, 0.5)),
    )


def info(width: int = 8, height: int = 6, **changed):
    """Return a sensor_msgs/CameraInfo."""
    fields = {
        "header": header(stamp(0), "camera"),
        "width": width,
        "height": height,
        "distortion_model": "plumb_bob",
        "d": floats([-0.1, 0.01, 0, 0, 0]),
        "k": floats([5, 0, 3.5, 0, 5, 2.5, 0, 0, 1]),
        "r": floats(np.eye(3).ravel()),
        "p": floats([4, 0, 3.5, -8, 0, 4, 2.5, 0, 0, 0, 1, 0]),
        "binning_x": 0,
        "binning_y": 0,
        "roi": make("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    }
    return make("sensor_msgs/CameraInfo", **fields | changed)


def compressed(seconds: float, pixels: np.ndarray | None = None, form: str = "png"):
    """Return a PNG of an RGB image or of numbers [h, w, 1]; invalid data without pixels."""
    data = np.arange(40, dtype=np.uint8)
    if pixels is not None:
        data = cv2.imencode(".png", np.ascontiguousarray(pixels[:, :, ::-1]))[1].ravel()
    return make("sensor_msgs/CompressedImage", header=header(stamp(seconds), "camera"), format=form, data=data)


def raw_image(seconds: float, encoding: str, pixels: np.ndarray):
    """Return a sensor_msgs/Image with two bytes of padding per row."""
    height = len(pixels)
    rows = np.pad(pixels.reshape(height, -1), ((0, 0), (0, 2)))
    return make(
        "sensor_msgs/Image",
        header=header(stamp(seconds), "camera"),
        height=height,
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.ravel(),
    )


def cloud(seconds: float, xyz=POINTS, dtype=POINT):
    """Return a cloud of points 10 ms apart."""
    points = np.zeros(len(xyz), dtype)
    if len(xyz):
        points["x"], points["y"], points["z"] = np.array(xyz, np.float32).T
    if "t" in dtype.names:
        points["t"] = 10_000_000 * np.arange(len(xyz))
    return message_from_points(points, stamp(seconds), "lidar")


IMAGE = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)


def record(path: Path, messages=None, *, until: float = 1.0) -> Path:
    """Write (seconds of arrival, topic, message); by default two images and two clouds."""
    if messages is None:
        messages = [(0.25, "/points", cloud(0.2)), (0.3, "/image", compressed(0.1, IMAGE))]
        messages += [(0.6, "/points", cloud(0.4)), (0.7, "/image", compressed(0.5, IMAGE))]
        messages += [(0, "/tf_static", tree()), (0, "/info", info())]
    driven = [(t, "/odom", odometry(t)) for t in np.arange(0, until + 0.01, 0.1).tolist()]
    with McapWriter(path) as writer:
        for seconds, topic, message in sorted([*messages, *driven], key=lambda entry: entry[0]):
            writer.write(topic, message, stamp(seconds))
    return path


def opened(path: Path, sensors: str = SENSORS) -> SensorLog:
    """Open the sensors of a recording."""
    return open_sensors(open_log(path), sensor_rig(sensors))
