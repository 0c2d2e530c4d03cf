"""A camera with lens distortion: rays through the distorted pixels, so that the image is what a real lens records."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from offpiste.simulation.own_body import body_hits
from offpiste.simulation.pose import Pose
from offpiste.simulation.scene import Hits, Scene, cast_rays, nearest


@dataclass(frozen=True)
class CameraSettings:
    """One camera.

    Attributes:
        name: of the frame and the topic.
        body_from_camera: optical frame: z forward, x right, y down.
        rate: images [1/s].
        width, height: [px].
        focal_length: fx, fy [px].
        centre: cx, cy [px]; the middle of the first pixel is (0, 0).
        distortion: k1, k2, p1, p2, k3 of the `plumb_bob` model (Brown 1966, as in OpenCV and ROS CameraInfo).
    """

    name: str
    body_from_camera: Pose
    rate: float = 10.0
    width: int = 960
    height: int = 594
    focal_length: tuple[float, float] = (530.0, 530.5)
    centre: tuple[float, float] = (483.2, 294.6)
    distortion: tuple[float, float, float, float, float] = (-0.17, 0.028, 0.0006, -0.0004, 0.0)

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """K of CameraInfo."""
        (fx, fy), (cx, cy) = self.focal_length, self.centre
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


class Camera:
    """A camera on its vehicle; knows where its rays go and which of them end on the vehicle itself.

    Attributes:
        settings: what it was made from.
        origin: of its rays in the body frame [m].
        rays: unit vectors in the body frame, row after row of the distorted image.
        own: where they end on the vehicle.
    """

    def __init__(self, settings: CameraSettings) -> None:
        self.settings = settings
        mount = settings.body_from_camera
        self.origin: Float[np.ndarray, " 3"] = mount.position
        self.rays: Float[np.ndarray, "n 3"] = (pixel_rays(settings) @ mount.rotation.T).astype(np.float32)
        self.own = body_hits(np.broadcast_to(self.origin, self.rays.shape), self.rays)

    def hits(self, scene: Scene, world_from_body: Pose) -> Hits:
        """What each pixel's middle shows, row after row: the truth."""
        origin = world_from_body.apply(self.origin[None])
        rays = self.rays @ world_from_body.rotation.T.astype(np.float32)
        return nearest(self.own, cast_rays(scene, np.broadcast_to(origin, rays.shape), rays))


def pixel_rays(settings: CameraSettings) -> Float[np.ndarray, "n 3"]:
    """Unit vectors in the optical frame through the middles of the pixels of the distorted image, row after row."""
    u, v = np.meshgrid(np.arange(settings.width, dtype=float), np.arange(settings.height, dtype=float))
    pixels = np.stack((u, v), axis=-1).reshape(-1, 1, 2)
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    distortion = np.array(settings.distortion)
    flat = cv2.undistortPoints(pixels, settings.matrix, distortion, None, None, None, until)[:, 0]
    rays = np.column_stack((flat, np.ones(len(flat))))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


FLAT = np.array(
    [[150, 180, 220], [170, 140, 100], [90, 70, 50], [60, 90, 40], [80, 100, 50], [140, 150, 70], [90, 90, 95]]
)


def render(
    scene: Scene, camera: Camera, world_from_body: Pose, rng: np.random.Generator
) -> UInt8[np.ndarray, "height width 3"]:
    """One image, RGB, distorted."""
    s = camera.settings
    return FLAT[camera.hits(scene, world_from_body).surface].reshape(s.height, s.width, 3).astype(np.uint8)
