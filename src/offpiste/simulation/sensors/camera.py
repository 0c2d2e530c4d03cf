"""A camera with lens distortion, rendered by rays through the distorted pixels."""

from dataclasses import dataclass
from functools import cache
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from offpiste.native.library import entry
from offpiste.rig.camera import CameraModel
from offpiste.simulation.rendering.appearance import Appearance
from offpiste.simulation.rendering.scene import Scene, body_hits
from offpiste.simulation.rendering.shading import Vehicle, shade_rays
from offpiste.simulation.sample import Pose

_develop = entry("develop", int, int, int, int, "f4", "f4", float, float, float, "u1", int, "u1")

LENS_BLUR = 0.6
"""Standard deviation of the blur by lens and demosaicing [px]."""
MIDDLE_GREY = 0.20
"""Target brightness of automatic exposure, linear; photographers use 18 %."""
TILE: Final = 4
"""Side of the tiles of pixels whose rays are cast as one packet."""
MODEL: Final = CameraModel(
    width=960,
    height=594,
    matrix=np.array([[530.0, 0.0, 483.2], [0.0, 530.5, 294.6], [0.0, 0.0, 1.0]]),
    distortion=(-0.17, 0.028, 0.0006, -0.0004, 0.0),
)
"""Model of the simulated cameras."""


@dataclass(frozen=True)
class CameraSettings:
    """Settings of one camera."""

    name: str  # name of the frame and the topic
    body_from_sensor: Pose  # pose of the optical frame (z forward, x right, y down)
    rate: float = 10.0  # image rate [1/s]
    model: CameraModel = MODEL  # image size, intrinsics and distortion
    vignetting: float = 0.25  # share of light lost in the corners
    full_well: float = 8000.0  # electrons at full brightness, which determine the shot noise
    read_noise: float = 0.002  # standard deviation relative to full brightness


class Camera:
    """Camera on a vehicle, with precomputed rays in the body frame."""

    def __init__(self, settings: CameraSettings) -> None:
        self.settings = settings
        self.origin: Float[np.ndarray, " 3"] = settings.body_from_sensor.position
        # Row-major pixel index of each ray; rays are ordered in tiles of `TILE` x `TILE` pixels.
        self.pixels: Int[np.ndarray, " n"] = tiled(*settings.model.size)
        rays = pixel_rays(settings.model) @ settings.body_from_sensor.rotation.T
        self.rays: Float[np.ndarray, "n 3"] = rays.astype(np.float32)[self.pixels]
        self.own = body_hits(self.origin, self.rays)  # on the vehicle itself

    def in_rows(self, values: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, "height width"]:
        """Return values of the rays as an image."""
        image = np.empty_like(values)
        image[self.pixels] = values
        return image.reshape(self.settings.model.size[::-1])


def tiled(width: int, height: int) -> Int[np.ndarray, " n"]:
    """Return the row-major pixel indices of an image in the order of its tiles."""
    v, u = np.divmod(np.arange(width * height, dtype=np.int32), width)
    return np.lexsort((u, v, u // TILE, v // TILE)).astype(np.int32)


def pixel_rays(model: CameraModel) -> Float[np.ndarray, "n 3"]:
    """Return the unit vectors in the optical frame through the pixel centres of the distorted image, row-major."""
    u, v = np.meshgrid(np.arange(model.width, dtype=float), np.arange(model.height, dtype=float))
    flat = model.unproject(np.column_stack((u.ravel(), v.ravel())))
    rays = np.column_stack((flat, np.ones(len(flat))))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def project_points(
    points_camera: Float[np.ndarray, "n 3"], model: CameraModel
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Return the distorted pixels of points in the optical frame, and whether they lie inside the image."""
    depth = points_camera[:, 2:]
    flat = points_camera[:, :2] / np.maximum(depth, 0.1)
    pixels = model.project(np.column_stack((flat, np.ones(len(flat)))))
    # Far outside the image the distortion polynomial folds points back into it.
    near = np.hypot(*flat.T) < 1.2 * np.hypot(*model.size) / np.trace(model.matrix[:2, :2])
    inside = ((pixels > -0.5) & (pixels < np.array(model.size) - 0.5) & (depth > 0.1)).all(axis=1)
    return pixels, near & inside


def render(
    scene: Scene, appearance: Appearance, camera: Camera, world_from_body: Pose, seed: int
) -> UInt8[np.ndarray, "height width 3"]:
    """Render a distorted RGB image with exposure, noise (by `seed`) and tone curve of a real camera."""
    s, (width, height) = camera.settings, camera.settings.model.size
    linear = np.empty((height, width, 3), np.float32)
    _shade(scene, appearance, camera, world_from_body, linear.reshape(-1, 3))
    blurred = cv2.GaussianBlur(linear, (0, 0), LENS_BLUR)
    image = np.empty((height, width, 3), np.uint8)
    gain = np.tile(exposure(linear) * appearance.light.exposure * appearance.light.balance.astype(np.float32), width)
    sensor = (s.vignetting, s.full_well, s.read_noise)

    def block(first: int, last: int) -> None:
        _develop(first, last, height, width, blurred, gain, *sensor, _tone_curve(), seed, image)

    scene.spread(height, block, size=32)
    return image


def exposure(linear: Float[np.ndarray, "height width 3"]) -> float:
    """Return the gain that brings the lower two thirds of an image close to middle grey, as real exposure does."""
    green = linear[linear.shape[0] // 3 :: 8, ::8, 1]
    return float((MIDDLE_GREY / max(float(np.minimum(green, 1.5).mean()), 1e-3)) ** 0.8)


def _shade(
    scene: Scene, appearance: Appearance, camera: Camera, world_from_body: Pose, linear: Float[np.ndarray, "n 3"]
) -> None:
    """Compute the light that reaches each pixel, linear RGB."""
    position, rotation = world_from_body.position, world_from_body.rotation
    origin = world_from_body.apply(camera.origin[None])[0]
    turned = np.ascontiguousarray(rotation.T, np.float32)
    pixel = 1 / float(max(np.diag(camera.settings.model.matrix)[:2]))
    sun = rotation.T @ appearance.light.sun + 1e-9
    vehicle = Vehicle(position, rotation, sun, appearance.shadow_boxes, appearance.paint)
    look = (appearance.ground, appearance.light, vehicle, pixel, origin)

    def block(first: int, last: int) -> None:
        rays = camera.rays[first:last] @ turned
        hits = scene.cast(origin[None], rays, camera.own.part(slice(first, last)))
        shade_rays(*look, rays, hits, camera.pixels[first:last], linear)

    scene.spread(len(linear), block)


@cache
def _tone_curve() -> UInt8[np.ndarray, " n"]:
    """Return the tone curve for brightness 0 ... 2: sRGB (IEC 61966-2-1) with a soft shoulder."""
    value = np.linspace(0, 2, 4096)
    value = np.where(value < 0.6, value, 0.6 + 0.4 * (1 - np.exp(-(value - 0.6) / 0.4)))
    value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.rint(255 * value).astype(np.uint8)
