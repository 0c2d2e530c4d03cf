"""Pictures of camera images: with the points of a scan, and beside the colours of their features."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from offpiste.core.files import write_whole
from offpiste.mapping.replay import Moment
from offpiste.perception.patch_grid import PatchGrid
from offpiste.report.feature_colours import colours

MOMENTS: Final = 4
"""Number of moments of a drive that are shown."""
WIDTH: Final = 2000
"""Width of a sheet [px]."""
NEAREST, FARTHEST = 2.0, 40.0
"""Distances drawn in the first and the last colour [m]."""

Picture = UInt8[np.ndarray, "_ _ 3"]


@dataclass(frozen=True)
class Album:
    """Pictures of the first moments after given times at which every camera has an image.

    Attributes:
        times: rising [s].
        limits: colours of the features; None without features.
        cameras: number of cameras to wait for, up to a second.
        overlays: each image with the points of the scan.
        besides: each image beside its features.
    """

    times: tuple[float, ...]
    limits: Float[np.ndarray, "2 3"] | None
    cameras: int
    overlays: list[Picture] = field(default_factory=list)
    besides: list[Picture] = field(default_factory=list)
    done: list[float] = field(default_factory=list)

    def add(self, moment: Moment) -> None:
        """Add pictures of a moment if they are due."""
        if len(self.done) == len(self.times) or moment.time < self.times[len(self.done)] or not moment.views:
            return
        if len(moment.views) < self.cameras and moment.time < self.times[len(self.done)] + 1.0:
            return
        self.done.append(moment.time)
        for number, (view, image) in enumerate(zip(moment.views, moment.images, strict=True)):
            if moment.projection is not None:
                mine = moment.projection.view == number
                image = overlay(image, moment.projection.pixel[mine], moment.projection.distance[mine])
            self.overlays.append(image)
            if self.limits is not None:
                patches = colours(moment.features[number], self.limits)
                self.besides.append(beside(moment.images[number], patches, view.camera.grid))


def times_between(start: float, end: float) -> tuple[float, ...]:
    """Return the times in the middle of `MOMENTS` equal pieces [s]."""
    return tuple(start + (end - start) * (2 * k + 1) / (2 * MOMENTS) for k in range(MOMENTS))


def overlay(image: Picture, pixels: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, " n"]) -> Picture:
    """Draw points into an RGB image, the nearest last: red near, blue far.

    Args:
        distance: from the camera [m]; the colour follows its logarithm.
    """
    if not len(pixels):
        return image
    share = np.log(np.clip(distance, NEAREST, FARTHEST) / NEAREST) / np.log(FARTHEST / NEAREST)
    shade = np.clip(255 * (0.95 - 0.9 * share), 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(shade[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    drawn = image.copy()
    for n in np.argsort(-distance):
        cv2.circle(drawn, tuple(np.rint(pixels[n]).astype(int).tolist()), 1, colours[n].tolist(), -1)
    return drawn


def beside(image: Picture, patches: UInt8[np.ndarray, "rows columns 3"], grid: PatchGrid) -> Picture:
    """Return an image and, right of it, the colours of its patches; the cropped edge is black."""
    right = np.zeros_like(image)
    right[grid.crop] = patches.repeat(grid.size, axis=0).repeat(grid.size, axis=1)
    return np.concatenate((image, right), axis=1)


def contact_sheet(pictures: list[Picture], columns: int) -> Picture:
    """Tile pictures of any sizes, scaled to one width and padded to one height with black."""
    width = WIDTH // columns
    scaled = [
        np.asarray(cv2.resize(p, (width, max(1, round(len(p) * width / p.shape[1]))), interpolation=cv2.INTER_AREA))
        for p in pictures
    ]
    tallest = max(len(p) for p in scaled)
    tiles = [np.pad(p, ((0, tallest - len(p)), (0, 0), (0, 0))) for p in scaled]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[start : start + columns], axis=1) for start in range(0, len(tiles), columns)]
    return np.concatenate(rows, axis=0)


def write_image(path: Path, picture: Picture) -> None:
    """Write an RGB picture as a PNG file, whole or not at all."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(picture[:, :, ::-1]))
    assert done, "OpenCV encodes every RGB image"
    write_whole(path, data.tofile)
