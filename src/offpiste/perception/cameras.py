"""Cameras of a log made ready for features: rectified to a pinhole, divided into patches, their own body masked."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from offpiste.logs.measurements import Camera
from offpiste.perception.masks import free_patches, mask_from_png, mask_from_polygons
from offpiste.perception.patches import PatchGrid
from offpiste.perception.rectify import Lens, Rectifier, make_rectifier


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
