"""Textured ground with walls, seen by one LiDAR and one camera of a vehicle that pitches, rolls, turns and brakes."""

from functools import cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from offpiste.calibration.samples import Grey, Scan, SmallCamera, small_camera
from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Camera, Lidar
from offpiste.logs.poses import Poses
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource, LidarSource

SECONDS = 8.0
MATRIX = np.array([[150.0, 0, 99.5], [0, 150, 74.5], [0, 0, 1]])
OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def mounting(rotation: Rotation, position) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), position
    return matrix


BODY_FROM_LIDAR = mounting(Rotation.from_euler("zy", (0.2, 0.05)), (0.3, 0.1, 1.8))
BODY_FROM_CAMERA = mounting(Rotation.from_euler("y", 0.45) * Rotation.from_matrix(OPTICAL), (0.6, 0.0, 1.6))


@cache
def poses(*, straight: bool = False) -> Poses:
    """Over rough ground; or straight ahead, which tells nothing of delays."""
    time = np.arange(0, SECONDS + 1.5, 0.01)
    wiggle = 0.0 if straight else 1.0
    yaw = wiggle * 0.4 * np.sin(0.8 * time)
    pitch, roll = wiggle * 0.05 * np.sin(3.1 * time), wiggle * 0.05 * np.sin(2.3 * time + 1)
    speed = 4.0 + wiggle * 1.5 * np.sin(1.3 * time)
    step = np.column_stack((np.cos(yaw), np.sin(yaw))) * speed[:, None] * 0.01
    place = np.column_stack((np.cumsum(step, axis=0), np.full(len(time), 0.5)))
    turn = Rotation.from_euler("ZYX", np.column_stack((yaw, pitch, roll))).as_quat()
    return Poses(Channel("position", "m", time, place), Channel("orientation", "1", time, turn), 0.5)


def surfaces(rng: np.random.Generator, middle: np.ndarray) -> np.ndarray:
    """Points of the ground and of two walls within 20 m of a place [m]."""
    ground = np.column_stack((rng.uniform(-20, 20, (6000, 2)) + middle[:2], np.zeros(6000)))
    side = np.column_stack((rng.uniform(-20, 20, 3000) + middle[0], np.full(3000, 9.0), rng.uniform(0, 4, 3000)))
    end = np.column_stack((np.full(2000, 48.0), rng.uniform(-20, 20, 2000) + middle[1], rng.uniform(0, 4, 2000)))
    points = np.concatenate((ground, side, end))
    return points[np.linalg.norm(points - middle, axis=1) < 20]


def lidar(turn=(0.0, 0.0, 0.0)) -> Lidar:
    """LiDAR whose mounting in the rig has a rotation error about the body's axes [rad]."""
    wrong = mounting(Rotation.from_rotvec(turn), (0, 0, 0))
    given = BODY_FROM_LIDAR.copy()
    given[:3, :3] = (wrong @ BODY_FROM_LIDAR)[:3, :3]
    return Lidar("top", given, LidarSource(topic="/points"))


@cache
def scans(*, late=0.0, straight=False) -> list[Scan]:
    """Sweeps of 0.1 s, stamped late [s]."""
    rng, made = np.random.default_rng(3), []
    for start in np.arange(0.2, SECONDS, 0.5):
        ticks = start + np.arange(100) * 1e-3
        world_from_lidar = poses(straight=straight).at(ticks) @ BODY_FROM_LIDAR
        world = surfaces(rng, world_from_lidar[0, :3, 3])
        which = rng.integers(0, 100, len(world))
        pose = world_from_lidar[which]
        points = np.einsum("nji,nj->ni", pose[:, :3, :3], world - pose[:, :3, 3])
        points += 0.01 * rng.standard_normal(points.shape)
        made.append(Scan(ticks + late, which, points, float(start + 0.05 + late)))
    return made


@cache
def texture() -> np.ndarray:
    """Spots of several sizes, 0.04 m a pixel, from (-10, -40) m on."""
    rng = np.random.default_rng(1)
    picture = sum(cv2.GaussianBlur(rng.standard_normal((2000, 1800)), (0, 0), s) * s for s in (1.5, 4.0))
    return np.clip(128 + 70 * picture, 0, 255).astype(np.float32)


def camera(turn=(0.0, 0.0, 0.0)) -> SmallCamera:
    """Turned like `lidar`."""
    given = BODY_FROM_CAMERA.copy()
    given[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ BODY_FROM_CAMERA[:3, :3]
    return small_camera(Camera("front", CameraModel(200, 150, MATRIX), given, CameraSource(topic="/image")))


@cache
def images(*, late=0.0, straight=False) -> list[Grey]:
    """Images of the ground at 2 Hz, stamped late [s]."""
    times = np.arange(0.25, SECONDS, 0.5)
    return [Grey(float(t + late), _image(poses(straight=straight).at(np.array([t]))[0])) for t in times]


def _image(world_from_body: np.ndarray) -> np.ndarray:
    x, y = np.meshgrid(np.arange(200.0), np.arange(150.0))
    world_from_camera = world_from_body @ BODY_FROM_CAMERA
    rays = np.stack((x, y, np.ones_like(x)), axis=-1) @ np.linalg.inv(MATRIX).T @ world_from_camera[:3, :3].T
    far = np.where(rays[..., 2] < -0.01, -world_from_camera[2, 3] / np.minimum(rays[..., 2], -0.01), 1e4)
    place = world_from_camera[:2, 3] + far[..., None] * rays[..., :2]
    column, row = ((place - [-10.0, -40.0]) / 0.04).astype(np.float32).transpose(2, 0, 1)
    return cv2.remap(texture(), np.ascontiguousarray(column), np.ascontiguousarray(row), cv2.INTER_AREA).astype(
        np.uint8
    )
