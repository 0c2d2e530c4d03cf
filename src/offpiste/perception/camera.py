"""From a lens's image to a pinhole's; the maps are computed once a camera.

Cameras of a log made ready for features: rectified to a pinhole, divided into patches, their own body masked.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int16, Shaped, UInt16

from offpiste.errors import PerceptionError
from offpiste.logs.measurements import Camera
from offpiste.perception.masks import free_patches, mask_from_png, mask_from_polygons
from offpiste.perception.patch_grid import PatchGrid

PLUMB_BOB, RATIONAL, FISHEYE = "plumb_bob", "rational_polynomial", "equidistant"

COEFFICIENTS: dict[str, tuple[int, ...]] = {PLUMB_BOB: (0, 4, 5), RATIONAL: (8, 12, 14), FISHEYE: (4,)}
"""Models of ROS's CameraInfo (sensor_msgs/distortion_models.hpp) and how many coefficients each has.

Brown, "Decentering distortion of lenses", 1966 (plumb_bob); Claus and Fitzgibbon, 2005 (rational); Kannala and Brandt,
2006 (equidistant).
"""

WIDEST = math.radians(65)
"""A pinhole's image reaches no further from its axis than this, whatever the lens sees: it would be all stretch."""

_ITERATIONS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)


@dataclass(frozen=True)
class Lens:
    """What a CameraInfo says.

    Attributes:
        width, height: of the image [px].
        matrix: K.
        distortion: D, in the order of OpenCV and ROS.
        model: a key of `COEFFICIENTS`.
        name: of the camera, for messages.

    Raises:
        PerceptionError: an unknown model, or numbers that are no calibration.
    """

    width: int
    height: int
    matrix: Float[np.ndarray, "3 3"]
    distortion: tuple[float, ...] = ()
    model: str = PLUMB_BOB
    name: str = "camera"

    def __post_init__(self) -> None:
        how = "mend its CameraInfo or its calibration in the rig"
        if self.model not in COEFFICIENTS:
            known = ", ".join(COEFFICIENTS)
            raise PerceptionError(f"unknown distortion model {self.model!r}", where=self.name, how=f"known are {known}")
        if len(self.distortion) not in COEFFICIENTS[self.model]:
            wanted = " or ".join(str(count) for count in COEFFICIENTS[self.model])
            raise PerceptionError(
                f"{len(self.distortion)} distortion coefficients, {self.model} has {wanted}", where=self.name, how=how
            )
        if self.width < 1 or self.height < 1:
            raise PerceptionError(f"an image of {self.width}x{self.height} pixels", where=self.name, how=how)
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.distortion).all()):
            raise PerceptionError("calibration is not finite", where=self.name, how=how)
        if self.matrix[0, 0] <= 0 or self.matrix[1, 1] <= 0:
            raise PerceptionError("uncalibrated: its focal length is 0 or less", where=self.name, how=how)

    def project(self, points_camera: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Places (x, y) of points in the distorted image [px]; points must lie in front (z > 0)."""
        if self.model == FISHEYE:
            return _fisheye(points_camera, self.matrix, self.distortion)
        points = np.ascontiguousarray(points_camera, dtype=np.float64)
        still = np.zeros(3)
        pixels, _ = cv2.projectPoints(points, still, still, self.matrix, np.array(self.distortion, dtype=np.float64))
        return pixels.reshape(-1, 2)

    def directions(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Tangents (x / z, y / z) of what places of the distorted image show; NaN where a pinhole sees nothing."""
        coefficients = np.array(self.distortion or (0.0,) * 4, dtype=np.float64)
        places = np.ascontiguousarray(pixels, dtype=np.float64)[:, None]
        if self.model == FISHEYE:
            found = cv2.fisheye.undistortPoints(places, self.matrix, coefficients)
        else:
            found = cv2.undistortPoints(places, self.matrix, coefficients, criteria=_ITERATIONS)
        directions = found.reshape(-1, 2)
        seen = np.all(np.abs(directions) < 1e3, axis=1)
        rays = np.column_stack((np.where(seen[:, None], directions, 0.0), np.ones(len(directions))))
        # The iteration may end anywhere where the polynomial folds back: only what leads back to the pixel counts.
        seen = seen & (np.abs(self.project(rays) - pixels).max(axis=1) < 0.1)
        return np.where(seen[:, None], directions, np.nan)

    def edges(self) -> tuple[Float[np.ndarray, "_ 2"], ...]:
        """Directions of the pixels along the image's edges: left, right, top, bottom."""
        columns, rows = np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64)
        return (
            self.directions(np.column_stack((np.zeros_like(rows), rows))),
            self.directions(np.column_stack((np.full_like(rows, self.width - 1), rows))),
            self.directions(np.column_stack((columns, np.zeros_like(columns)))),
            self.directions(np.column_stack((columns, np.full_like(columns, self.height - 1)))),
        )


def _fisheye(
    points: Float[np.ndarray, "n 3"], matrix: Float[np.ndarray, "3 3"], distortion: Sequence[float]
) -> Float[np.ndarray, "n 2"]:
    pixels, _ = cv2.fisheye.projectPoints(
        np.ascontiguousarray(points, dtype=np.float64)[:, None], np.zeros(3), np.zeros(3), matrix, np.array(distortion)
    )
    return pixels.reshape(-1, 2)


@dataclass(frozen=True)
class Rectifier:
    """Turns a camera's images into those of a pinhole.

    Attributes:
        matrix: K of the pinhole.
        width, height: of the rectified image [px].
        valid: pixels of the rectified image that the lens saw.
        source_width, source_height: of the images it takes [px].
        places, fractions: where its pixels lie in those, as `cv2.convertMaps` packs it.
    """

    name: str
    matrix: Float[np.ndarray, "3 3"]
    width: int
    height: int
    source_width: int
    source_height: int
    valid: Bool[np.ndarray, "height width"]
    places: Int16[np.ndarray, "height width 2"]
    fractions: UInt16[np.ndarray, "height width"]

    def __call__(self, image: Shaped[np.ndarray, "h w *c"]) -> Shaped[np.ndarray, "height width *c"]:
        """The rectified image; black where the lens saw nothing.

        Raises:
            PerceptionError: an image of another size than the calibration's.
        """
        height, width = image.shape[:2]
        if (width, height) != (self.source_width, self.source_height):
            raise PerceptionError(
                f"an image of {width}x{height}, calibrated for {self.source_width}x{self.source_height}",
                where=self.name,
                how="give the CameraInfo of these images",
            )
        source = np.ascontiguousarray(image)
        edge = cv2.BORDER_REPLICATE  # half a pixel around the image is still the image
        rectified = np.asarray(cv2.remap(source, self.places, self.fractions, cv2.INTER_LINEAR, borderMode=edge))
        rectified[~self.valid] = 0
        return rectified

    def mask(self, mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "height width"]:
        """A mask of the lens's image in the rectified one; false where the lens saw nothing."""
        return self(255 * mask.astype(np.uint8)) > 127


def pinhole_matrix(lens: Lens) -> Float[np.ndarray, "3 3"]:
    """K of the pinhole with the widest view that the lens's image fills without a gap, for an image of its size.

    The ratio of the focal lengths stays the lens's; without distortion this is the lens's own K.

    Raises:
        PerceptionError: the lens's model cannot be inverted over its image.
    """
    limit = math.tan(WIDEST)
    left, right, top, bottom = lens.edges()
    # What a pinhole cannot see (NaN) bounds nothing, but only a fisheye sees such things.
    low = np.array([np.fmax.reduce(left[:, 0], initial=-limit), np.fmax.reduce(top[:, 1], initial=-limit)])
    high = np.array([np.fmin.reduce(right[:, 0], initial=limit), np.fmin.reduce(bottom[:, 1], initial=limit)])
    unseen = np.isnan(np.concatenate((left, right, top, bottom))).any()
    if not (low < high).all() or (unseen and lens.model != FISHEYE):
        raise PerceptionError(
            "its distortion folds the image over", where=lens.name, how="check the order and sign of its coefficients"
        )
    last = np.array([lens.width - 1, lens.height - 1])
    own = lens.matrix[[0, 1], [0, 1]]
    focal_length = own * (last / (high - low) / own).max()
    matrix = np.eye(3)
    matrix[[0, 1], [0, 1]], matrix[:2, 2] = focal_length, last / 2 - focal_length * (low + high) / 2
    return matrix


def make_rectifier(
    lens: Lens, *, matrix: Float[np.ndarray, "3 3"] | None = None, size: tuple[int, int] | None = None
) -> Rectifier:
    """Compute the maps of one camera.

    Args:
        matrix: K of the pinhole, for an image of the lens's size; `pinhole_matrix` if it is not given.
        size: width and height of the rectified image [px]; the lens's if it is not given. The view stays the same.
            Less than half of the lens's would alias: shrink those images first.

    Raises:
        PerceptionError: see `pinhole_matrix`.
    """
    width, height = size or (lens.width, lens.height)
    full = pinhole_matrix(lens) if matrix is None else matrix
    scale = np.diag([width / lens.width, height / lens.height, 1.0])
    # The middle of the first pixel is (0, 0), so scaling is about the corner (-0.5, -0.5).
    corner = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    pinhole = np.linalg.inv(corner) @ scale @ corner @ full

    pixels = np.stack((*np.meshgrid(np.arange(width), np.arange(height)), np.ones((height, width))), axis=-1)
    rays = pixels.reshape(-1, 3) @ np.linalg.inv(pinhole).T
    places = lens.project(rays)
    # Beyond what the edges show, a polynomial may fold back into the image.
    reach = 1.01 * np.nanmax(np.linalg.norm(np.concatenate(lens.edges()), axis=1), initial=0.0)
    places[np.linalg.norm(rays[:, :2], axis=1) > reach] = -10.0
    places = places.reshape(height, width, 2)
    valid = np.all((places > -0.5) & (places < np.array([lens.width, lens.height]) - 0.5), axis=2)
    coarse, fractions = cv2.convertMaps(places.astype(np.float32), np.empty(0, np.float32), cv2.CV_16SC2)
    return Rectifier(
        name=lens.name,
        matrix=pinhole,
        width=width,
        height=height,
        source_width=lens.width,
        source_height=lens.height,
        valid=np.asarray(valid),
        places=np.asarray(coarse),
        fractions=np.asarray(fractions),
    )


@dataclass(frozen=True)
class PinholeCamera:
    """A rectified camera.

    Attributes:
        rectifier: turns recorded images into the ones that all else here is about.
        body_from_camera: z forward, x right, y down.
        grid: its patches.
        free: patches that show the world: not the vehicle itself, and nothing that the lens did not see.
    """

    name: str
    rectifier: Rectifier
    body_from_camera: Float[np.ndarray, "4 4"]
    grid: PatchGrid
    free: Bool[np.ndarray, "rows columns"]

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """K of the rectified image."""
        return self.rectifier.matrix

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the rectified image [px]."""
        return self.rectifier.width, self.rectifier.height


def lens_of(camera: Camera) -> Lens:
    """Its calibration.

    Raises:
        PerceptionError: that is none.
    """
    m = camera.model
    return Lens(m.width, m.height, m.matrix, m.distortion, m.model, camera.name)


def own_body(camera: Camera) -> Bool[np.ndarray, "h w"]:
    """Where the recorded image shows the vehicle itself, as the rig says: its picture and its polygons together.

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
    rectifier = make_rectifier(lens_of(camera), size=size)
    grid = PatchGrid(rectifier.width, rectifier.height, patch)
    # Masked where the vehicle is, not where the world is not: what lies outside of the recorded image is no world.
    unusable = rectifier.mask(own_body(camera)) | ~rectifier.valid
    return PinholeCamera(camera.name, rectifier, camera.body_from_camera, grid, free_patches(unusable, grid))
