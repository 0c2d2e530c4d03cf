"""A recorded drive of six seconds with textured images, level ground in the scans and steady poses."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from offpiste.logs.ros.writer import McapWriter
from sensor_bags import SENSORS, cloud, compressed, info, odometry, sensor_rig_text, stamp, tree

SECONDS = 6.0
SIDE = 56
"""Width and height of images [px], four patches."""
_RNG = np.random.default_rng(0)
PICTURES = _RNG.integers(0, 256, (40, SIDE, SIDE, 3), dtype=np.uint8)
X, Y = np.meshgrid(np.arange(-6, 25, 0.25), np.arange(-5, 5.1, 0.25))
LIDAR_HEIGHT = 2.5
AROUND = np.column_stack((Y.ravel(), -(X.ravel() - 1), np.full(X.size, -LIDAR_HEIGHT)))
"""Level ground at the wheels' height; the LiDAR's x points to the left, and it sits 1 m ahead."""
WIDE = info(SIDE, SIDE, d=np.zeros(5), k=np.array([30.0, 0, 27.5, 0, 30, 27.5, 0, 0, 1]))
STATIC = [(0.0, "/tf_static", tree()), (0.0, "/info", WIDE)]
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
RIG = sensor_rig_text(SENSORS.replace('time_field = "t"\ntime_unit = "ns"\n', ""))


def images(first: float = 0.0, last: float = SECONDS, stamped: Callable[[float], float] = lambda t: t):
    times = np.arange(first + 0.05, last, 0.25).tolist()
    return [(t, "/image", compressed(stamped(t), PICTURES[n])) for n, t in enumerate(times)]


def clouds(points: np.ndarray = AROUND, first: float = 0.0, last: float = SECONDS):
    return [(t, "/points", cloud(t, points, POINT)) for t in np.arange(first + 0.1, last, 0.25).tolist()]


def poses(aside: Callable[[float], float] = lambda t: 0.0):
    return [(t, "/odom", odometry(t, aside(t))) for t in np.arange(0, SECONDS + 0.01, 0.05).tolist()]


def written(path: Path, *parts) -> Path:
    messages = sorted((m for part in parts for m in part), key=lambda m: m[0])
    with McapWriter(path) as writer:
        for seconds, topic, message in messages:
            writer.write(topic, message, stamp(seconds))
    return path


def good_drive(folder: Path) -> Path:
    """A folder with good.mcap and rig.toml."""
    (folder / "rig.toml").write_text(RIG)
    written(folder / "good.mcap", STATIC, images(), clouds(), poses())
    return folder
