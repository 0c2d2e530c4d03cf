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

MOST_OF_A_PATCH: Final = 0.1
"""Largest share of the vehicle's body, or of unseen pixels, in a usable patch."""


@dataclass(frozen=True)
class Rectifier:
    """Rectification of a camera's images to a pinhole.

    Attributes:
        name: of the camera, for messages.
        source, pinhole: models of the recorded and of the rectified images.
        valid: rectified pixels inside the recorded image.
        places, fractions: positions of rectified pixels in the recorded image, as packed by `cv2.convertMaps`.
    """

    name: str
    source: CameraModel
    pinhole: CameraModel
    valid: Bool[np.ndarray, "height width"]
    places: Int16[np.ndarray, "height width 2"]
    fractions: UInt16[np.ndarray, "height width"]

    def __call__(self, image: Shaped[np.ndarray, "h w *c"]) -> Shaped[np.ndarray, "height width *c"]:
        """Rectify an image; invalid pixels are black.

        Raises:
            PerceptionError: the image's size is not the calibration's.
        """
        height, width = image.shape[:2]
        if (width, height) != self.source.size:
            raise PerceptionError(
                f"an image of {width}x{height}, calibrated for {self.source.width}x{self.source.height}",
                where=self.name,
                how="give the calibration (CameraInfo) of these images",
            )
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

    Raises:
        PerceptionError: the model cannot be inverted over its image.
    """
    limit = math.tan(WIDEST)
    left, right, top, bottom = model.edges()
    # Rays behind a pinhole are NaN, which only a fisheye may have; they set no bound.
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
    """Compute the rectification of a camera.

    Args:
        name: of the camera, for messages.
        matrix: K of the pinhole, for an image of the camera's size; `pinhole_matrix` by default.
        size: width and height of the rectified image with the same view [px]; the camera's by default. Less than half
            of the camera's size causes aliasing.

    Raises:
        PerceptionError: see `CameraModel.validate` and `pinhole_matrix`.
    """
    model.validate(name)
    width, height = size or model.size
    full = pinhole_matrix(model, name) if matrix is None else matrix
    scale = np.diag([width / model.width, height / model.height, 1.0])
    # The centre of the first pixel is (0, 0), so scaling is about the corner (-0.5, -0.5).
    corner = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    target = np.linalg.inv(corner) @ scale @ corner @ full

    pixels = np.stack((*np.meshgrid(np.arange(width), np.arange(height)), np.ones((height, width))), axis=-1)
    rays = pixels.reshape(-1, 3) @ np.linalg.inv(target).T
    places = model.project(rays)
    # Beyond the edges of the image, a polynomial may fold back into it.
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
    """Camera with rectified images.

    Attributes:
        body_from_camera: z forward, x right, y down.
        grid: patches of the rectified image.
        free: patches without the vehicle's body and invalid pixels.
    """

    name: str
    rectifier: Rectifier
    body_from_camera: Float[np.ndarray, "4 4"]
    grid: PatchGrid
    free: Bool[np.ndarray, "rows columns"]

    @property
    def model(self) -> CameraModel:
        """Pinhole model of the rectified images."""
        return self.rectifier.pinhole


def _mask_from_png(path: Path, width: int, height: int) -> Bool[np.ndarray, "height width"]:
    """Read a mask of the vehicle's body from a picture of the camera's size [px]: all pixels but black ones.

    Raises:
        PerceptionError: there is no such picture, or it has another size.
    """
    content = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.empty(0, np.uint8)
    picture = decoded_picture(content, grey=True)
    if picture is None:
        raise PerceptionError("cannot be read as a picture", where=path, how="give a PNG of the camera's size")
    if picture.shape != (height, width):
        raise PerceptionError(
            f"a mask of {picture.shape[1]}x{picture.shape[0]} for a camera of {width}x{height}",
            where=path,
            how="paint it on an image of that camera",
        )
    return picture > 0


def mask_from_polygons(
    polygons: Sequence[Sequence[tuple[float, float]]], width: int, height: int
) -> Bool[np.ndarray, "height width"]:
    """Return the mask of pixels inside polygons, whose corners (x, y) may lie outside the image [px].

    Raises:
        PerceptionError: a polygon of fewer than three corners.
    """
    mask = np.zeros((height, width), dtype=np.uint8)
    for polygon in polygons:
        if len(polygon) < 3:
            raise PerceptionError(
                f"a mask's polygon of {len(polygon)} corners", how="give three corners (x, y) or more"
            )
        corners = np.rint(np.asarray(polygon, dtype=np.float64)).astype(np.int32)
        # One at a time: polygons filled together cancel out where they overlap.
        cv2.fillPoly(mask, [corners], 1)
    return mask.astype(bool)


def own_body(camera: Camera) -> Bool[np.ndarray, "h w"]:
    """Return the mask of the vehicle's body in the recorded image, from the rig's picture and polygons.

    Raises:
        PerceptionError: the picture is missing or has another size.
    """
    width, height = camera.model.width, camera.model.height
    mask = mask_from_polygons(camera.source.own_body, width, height)
    if camera.source.mask:
        mask |= _mask_from_png(Path(camera.source.mask), width, height)
    return mask


def make_pinhole_camera(camera: Camera, patch: int) -> PinholeCamera:
    """Compute the rectification and the usable patches of a camera.

    Args:
        patch: side of a patch [px].

    Raises:
        PerceptionError: a calibration or mask is invalid, or the image is smaller than a patch.
    """
    rectifier = make_rectifier(camera.model, name=camera.name)
    grid = PatchGrid(*rectifier.pinhole.size, patch)
    unusable = rectifier.mask(own_body(camera)) | ~rectifier.valid
    free = grid.share(unusable) <= MOST_OF_A_PATCH
    return PinholeCamera(camera.name, rectifier, camera.body_from_camera, grid, free)
