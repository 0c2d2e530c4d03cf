"""Rectification of images to a pinhole, division into patches, and masks of the vehicle's own body."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int16, Shaped, UInt16

from offpiste.core.errors import PerceptionError
from offpiste.logs.measurements import Camera, decoded_picture
from offpiste.perception.patch_grid import PatchGrid
from offpiste.rig.camera import FISHEYE, CameraModel

WIDEST: Final = math.radians(65)
"""Largest angle from the axis of a pinhole to the edge of its image; beyond, images are mostly stretched [rad]."""

MOST_OF_A_PATCH: Final = 0.1  # largest share of the vehicle's body, or of unseen pixels, in a usable patch


@dataclass(frozen=True)
class Rectifier:
    """Rectification of a camera's images to a pinhole; invalid pixels are black."""

    name: str  # of the camera, for messages
    source: CameraModel  # of recorded images
    pinhole: CameraModel  # of rectified images
    valid: Bool[np.ndarray, "height width"]  # rectified pixels inside the recorded image
    places: Int16[np.ndarray, "height width 2"]  # positions in the recorded image, as packed by `cv2.convertMaps`
    fractions: UInt16[np.ndarray, "height width"]

    def __call__(self, image: Shaped[np.ndarray, "h w *c"]) -> Shaped[np.ndarray, "height width *c"]:
        """Rectify an image; raise `PerceptionError` if its size is not the calibration's."""
        height, width = image.shape[:2]
        if (width, height) != self.source.size:
            what = f"images are {width}x{height} pixels, the calibration {self.source.width}x{self.source.height}"
            raise PerceptionError(what, where=self.name, how="give the calibration (CameraInfo) of these images")
        recorded = np.ascontiguousarray(image)
        edge = cv2.BORDER_REPLICATE  # pixels reach half a pixel beyond their centres
        rectified = np.asarray(cv2.remap(recorded, self.places, self.fractions, cv2.INTER_LINEAR, borderMode=edge))
        rectified[~self.valid] = 0
        return rectified

    def mask(self, mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "height width"]:
        """Rectify a mask of the recorded image; false at invalid pixels."""
        return self(255 * mask.astype(np.uint8)) > 127


def pinhole_matrix(model: CameraModel, name: str = "camera") -> Float[np.ndarray, "3 3"]:
    """Return K of the widest pinhole view without invalid pixels, for an image of the camera's size.

    The ratio of the focal lengths is kept; without distortion the result is the camera's own K.
    """
    limit = math.tan(WIDEST)
    left, right, top, bottom = model.edges()
    # Rays behind a pinhole are NaN, which only a fisheye may have; they set no bound.
    low = np.array([np.fmax.reduce(left[:, 0], initial=-limit), np.fmax.reduce(top[:, 1], initial=-limit)])
    high = np.array([np.fmin.reduce(right[:, 0], initial=limit), np.fmin.reduce(bottom[:, 1], initial=limit)])
    unseen = np.isnan(np.concatenate((left, right, top, bottom))).any()
    if not (low < high).all() or (unseen and model.distortion_model != FISHEYE):
        how = "check the order and sign of its coefficients"
        raise PerceptionError("its distortion folds the image over", where=name, how=how)
    last = np.array([model.width - 1, model.height - 1])
    own = model.matrix[[0, 1], [0, 1]]
    focal_length = own * (last / (high - low) / own).max()
    matrix = np.eye(3)
    matrix[[0, 1], [0, 1]], matrix[:2, 2] = focal_length, last / 2 - focal_length * (low + high) / 2
    return matrix


def make_rectifier(model: CameraModel, *, name: str = "camera", size: tuple[int, int] | None = None) -> Rectifier:
    """Compute the rectification of a camera; raise `PerceptionError` for an invalid calibration.

    Args:
        name: of the camera, for messages.
        size: width and height of the rectified image with the same view [px]; the camera's by default. Less than half
            of the camera's size causes aliasing.
    """
    model.validate(name)
    width, height = size or model.size
    scale = np.diag([width / model.width, height / model.height, 1.0])
    # The centre of the first pixel is (0, 0), so scaling is about the corner (-0.5, -0.5).
    corner = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    target = np.linalg.inv(corner) @ scale @ corner @ pinhole_matrix(model, name)

    pixels = np.stack((*np.meshgrid(np.arange(width), np.arange(height)), np.ones((height, width))), axis=-1)
    places = model.project(pixels.reshape(-1, 3) @ np.linalg.inv(target).T).reshape(height, width, 2)
    valid = np.all((places > -0.5) & (places < np.array(model.size) - 0.5), axis=2)
    coarse, fractions = cv2.convertMaps(places.astype(np.float32), np.empty(0, np.float32), cv2.CV_16SC2)
    pinhole = CameraModel(width, height, target)
    return Rectifier(name, model, pinhole, np.asarray(valid), np.asarray(coarse), np.asarray(fractions))


@dataclass(frozen=True)
class PinholeCamera:
    """Camera with rectified images."""

    name: str
    rectifier: Rectifier
    body_from_camera: Float[np.ndarray, "4 4"]  # z forward, x right, y down
    grid: PatchGrid  # of the rectified image
    free: Bool[np.ndarray, "rows columns"]  # patches without the vehicle's body and invalid pixels

    @property
    def model(self) -> CameraModel:
        """Pinhole model of the rectified images."""
        return self.rectifier.pinhole


def mask_from_polygons(
    polygons: Sequence[Sequence[tuple[float, float]]], width: int, height: int
) -> Bool[np.ndarray, "height width"]:
    """Return the mask of pixels inside polygons, whose corners (x, y) may lie outside the image [px]."""
    mask = np.zeros((height, width), dtype=np.uint8)
    for polygon in polygons:
        if len(polygon) < 3:
            what = f"a mask polygon has {len(polygon)} corners"
            raise PerceptionError(what, how="give three corners (x, y) or more")
        # One at a time: polygons filled together cancel out where they overlap.
        cv2.fillPoly(mask, [np.rint(np.asarray(polygon, dtype=np.float64)).astype(np.int32)], 1)
    return mask.astype(bool)


def own_body(camera: Camera) -> Bool[np.ndarray, "h w"]:
    """Return the mask of the vehicle's body in the recorded image, from the rig's polygons and picture.

    In the picture, all pixels but black ones are the body; `PerceptionError` if it is missing or of another size.
    """
    width, height = camera.model.size
    mask = mask_from_polygons(camera.source.own_body, width, height)
    if camera.source.mask:
        path = Path(camera.source.mask)
        content = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.empty(0, np.uint8)
        picture = decoded_picture(content, cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise PerceptionError("cannot be read as a picture", where=path, how="give a PNG of the camera's size")
        if picture.shape != (height, width):
            what = f"the mask has {picture.shape[1]}x{picture.shape[0]} pixels, but the camera has {width}x{height}"
            raise PerceptionError(what, where=path, how="paint it on an image of that camera")
        mask |= picture > 0
    return mask


def make_pinhole_camera(camera: Camera, patch: int) -> PinholeCamera:
    """Compute the rectification and the usable patches of `patch` pixels of a camera."""
    rectifier = make_rectifier(camera.model, name=camera.name)
    grid = PatchGrid(*rectifier.pinhole.size, patch)
    unusable = rectifier.mask(own_body(camera)) | ~rectifier.valid
    free = grid.share(unusable) <= MOST_OF_A_PATCH
    return PinholeCamera(camera.name, rectifier, camera.body_from_camera, grid, free)
