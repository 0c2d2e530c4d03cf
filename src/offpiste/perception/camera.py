"""Cameras made ready for features: images rectified to a pinhole, divided into patches, the vehicle itself masked."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int16, Shaped, UInt16

from offpiste.core.errors import PerceptionError
from offpiste.logs.measurements import Camera
from offpiste.perception.masks import free_patches, mask_from_png, mask_from_polygons
from offpiste.perception.patch_grid import PatchGrid
from offpiste.rig.camera import FISHEYE, CameraModel

WIDEST: Final = math.radians(65)
"""Largest angle from the axis of a pinhole to its image's edge, however wide the camera: beyond, it is all stretch."""


@dataclass(frozen=True)
class Rectifier:
    """Turns a camera's images into those of a pinhole.

    Attributes:
        name: of the camera, for messages.
        source: model of the images it takes.
        pinhole: model of the rectified images.
        valid: pixels of the rectified image that the camera saw.
        places, fractions: places of its pixels in the recorded image, as `cv2.convertMaps` packs them.
    """

    name: str
    source: CameraModel
    pinhole: CameraModel
    valid: Bool[np.ndarray, "height width"]
    places: Int16[np.ndarray, "height width 2"]
    fractions: UInt16[np.ndarray, "height width"]

    def __call__(self, image: Shaped[np.ndarray, "h w *c"]) -> Shaped[np.ndarray, "height width *c"]:
        """The rectified image; black where the camera saw nothing.

        Raises:
            PerceptionError: an image of another size than the calibration's.
        """
        height, width = image.shape[:2]
        if (width, height) != self.source.size:
            raise PerceptionError(
                f"an image of {width}x{height}, calibrated for {self.source.width}x{self.source.height}",
                where=self.name,
                how="give the CameraInfo of these images",
            )
        recorded = np.ascontiguousarray(image)
        edge = cv2.BORDER_REPLICATE  # half a pixel around the image is still the image
        rectified = np.asarray(cv2.remap(recorded, self.places, self.fractions, cv2.INTER_LINEAR, borderMode=edge))
        rectified[~self.valid] = 0
        return rectified

    def mask(self, mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "height width"]:
        """A mask of the recorded image in the rectified one; false where the camera saw nothing."""
        return self(255 * mask.astype(np.uint8)) > 127


def pinhole_matrix(model: CameraModel, name: str = "camera") -> Float[np.ndarray, "3 3"]:
    """K of the pinhole with the widest view that the camera's image fills without a gap, for an image of its size.

    The ratio of the focal lengths stays the camera's; without distortion this is the camera's own K.

    Raises:
        PerceptionError: the model cannot be inverted over its image.
    """
    limit = math.tan(WIDEST)
    left, right, top, bottom = model.edges()
    # What a pinhole cannot see (NaN) bounds nothing, but only a fisheye sees such things.
    low = np.array([np.fmax.reduce(left[:, 0], initial=-limit), np.fmax.reduce(top[:, 1], initial=-limit)])
    high = np.array([np.fmin.reduce(right[:, 0], initial=limit), np.fmin.reduce(bottom[:, 1], initial=limit)])
    unseen = np.isnan(np.concatenate((left, right, top, bottom))).any()
    if not (low < high).all() or (unseen and model.distortion_model != FISHEYE):
        raise PerceptionError(
            "its distortion folds the image over", where=name, how="check the order and sign of its coefficients"
        )
    last = np.array([model.width - 1, model.height - 1])
    own = model.matrix[[0, 1], [0, 1]]
    focal_length = own * (last / (high - low) / own).max()
    matrix = np.eye(3)
    matrix[[0, 1], [0, 1]], matrix[:2, 2] = focal_length, last / 2 - focal_length * (low + high) / 2
    return matrix


def make_rectifier(
    model: CameraModel,
    *,
    name: str = "camera",
    matrix: Float[np.ndarray, "3 3"] | None = None,
    size: tuple[int, int] | None = None,
) -> Rectifier:
    """Compute the maps of one camera.

    Args:
        name: of the camera, for messages.
        matrix: K of the pinhole, for an image of the camera's size; `pinhole_matrix` if it is not given.
        size: width and height of the rectified image [px]; the camera's if it is not given. The view stays the same.
            Less than half of the camera's would alias: shrink those images first.

    Raises:
        PerceptionError: see `CameraModel.validate` and `pinhole_matrix`.
    """
    model.validate(name)
    width, height = size or model.size
    full = pinhole_matrix(model, name) if matrix is None else matrix
    scale = np.diag([width / model.width, height / model.height, 1.0])
    # The middle of the first pixel is (0, 0), so scaling is about the corner (-0.5, -0.5).
    corner = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    target = np.linalg.inv(corner) @ scale @ corner @ full

    pixels = np.stack((*np.meshgrid(np.arange(width), np.arange(height)), np.ones((height, width))), axis=-1)
    rays = pixels.reshape(-1, 3) @ np.linalg.inv(target).T
    places = model.project(rays)
    # Beyond what the edges show, a polynomial may fold back into the image.
    reach = 1.01 * np.nanmax(np.linalg.norm(np.concatenate(model.edges()), axis=1), initial=0.0)
    places[np.linalg.norm(rays[:, :2], axis=1) > reach] = -10.0
    places = places.reshape(height, width, 2)
    valid = np.all((places > -0.5) & (places < np.array([model.width, model.height]) - 0.5), axis=2)
    coarse, fractions = cv2.convertMaps(places.astype(np.float32), np.empty(0, np.float32), cv2.CV_16SC2)
    return Rectifier(
        name=name,
        source=model,
        pinhole=CameraModel(width, height, target),
        valid=np.asarray(valid),
        places=np.asarray(coarse),
        fractions=np.asarray(fractions),
    )


@dataclass(frozen=True)
class PinholeCamera:
    """A camera whose images are rectified.

    Attributes:
        rectifier: turns recorded images into those that `model`, `grid` and `free` describe.
        body_from_camera: z forward, x right, y down.
        grid: its patches.
        free: patches that show the world: neither the vehicle itself nor what the camera did not see.
    """

    name: str
    rectifier: Rectifier
    body_from_camera: Float[np.ndarray, "4 4"]
    grid: PatchGrid
    free: Bool[np.ndarray, "rows columns"]

    @property
    def model(self) -> CameraModel:
        """The pinhole of the rectified images."""
        return self.rectifier.pinhole


def own_body(camera: Camera) -> Bool[np.ndarray, "h w"]:
    """Mask of the vehicle itself in the recorded image: the rig's picture and polygons together.

    Raises:
        PerceptionError: no such picture, or one of another size.
    """
    width, height = camera.model.width, camera.model.height
    mask = mask_from_polygons(camera.source.own_body, width, height)
    if camera.source.mask:
        mask |= mask_from_png(Path(camera.source.mask), width, height)
    return mask


def make_pinhole_camera(camera: Camera, patch: int, *, size: tuple[int, int] | None = None) -> PinholeCamera:
    """Compute the maps and masks of a camera once.

    Args:
        patch: side of a patch [px].
        size: width and height of the rectified image [px]; the recorded one's by default.

    Raises:
        PerceptionError: a calibration or mask is wrong, or the image smaller than a patch.
    """
    rectifier = make_rectifier(camera.model, name=camera.name, size=size)
    grid = PatchGrid(*rectifier.pinhole.size, patch)
    # Masked where the vehicle is, not where the world is not: what lies outside of the recorded image is no world.
    unusable = rectifier.mask(own_body(camera)) | ~rectifier.valid
    return PinholeCamera(camera.name, rectifier, camera.body_from_camera, grid, free_patches(unusable, grid))
