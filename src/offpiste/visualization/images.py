"""Camera images as pictures: scan points in them, and the colours of their features."""

from collections.abc import Sequence
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


def beside(
    image: UInt8[np.ndarray, "h w 3"], patches: UInt8[np.ndarray, "rows columns 3"], grid: PatchGrid
) -> UInt8[np.ndarray, "h w2 3"]:
    """An image and, right of it, its patches' colours in their places; the cropped edge is black."""
    right = np.zeros_like(image)
    right[grid.crop] = patches.repeat(grid.size, axis=0).repeat(grid.size, axis=1)
    return np.concatenate((image, right), axis=1)


def sheet(pictures: Sequence[UInt8[np.ndarray, "h w 3"]], *, columns: int = 2) -> UInt8[np.ndarray, "H W 3"]:
    """Tile pictures of equal size in `columns` columns; unused tiles are black."""
    blank = [np.zeros_like(pictures[0])] * (-len(pictures) % columns)
    filled = [*pictures, *blank]
    rows = [np.concatenate(filled[start : start + columns], axis=1) for start in range(0, len(filled), columns)]
    return np.concatenate(rows, axis=0)


def write_png(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write an RGB picture, whole or not at all."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(picture[:, :, ::-1]))
    assert done, "OpenCV encodes every RGB image"
    write_whole(path, data.tofile)


def overlay(
    image: UInt8[np.ndarray, "h w 3"],
    pixels: Float[np.ndarray, "n 2"],
    distance: Float[np.ndarray, " n"],
    *,
    farthest: float = 40.0,
    radius: int = 1,
) -> UInt8[np.ndarray, "h w 3"]:
    """An RGB image with points drawn into it, the nearest last: red near, blue far.

    Args:
        distance: from the camera [m].
        farthest: is drawn in the last colour, in the logarithm of distance from 2 m on [m].
        radius: of a point [px].
    """
    if not len(pixels):
        return image
    share = np.log(np.clip(distance, 2, farthest) / 2) / np.log(farthest / 2)
    shade = np.clip(255 * (0.95 - 0.9 * share), 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(shade[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    drawn = image.copy()
    for n in np.argsort(-distance):
        cv2.circle(drawn, tuple(np.rint(pixels[n]).astype(int).tolist()), radius, colours[n].tolist(), -1)
    return drawn


MOMENTS: Final = 4
"""Number of moments of a drive that are shown."""

WIDTH: Final = 2000
"""Width of a sheet [px]."""

Picture = UInt8[np.ndarray, "_ _ 3"]


@dataclass(frozen=True)
class Album:
    """Pictures of the first moments after given times at which every camera has an image.

    Attributes:
        times: rising [s].
        limits: colours of the features; None without features.
        cameras: number of cameras to wait for, up to a second.
        overlays: each image with the points in it, red near and blue far.
        besides: each image beside its features.
    """

    times: tuple[float, ...]
    limits: Float[np.ndarray, "2 3"] | None
    cameras: int
    overlays: list[Picture] = field(default_factory=list)
    besides: list[Picture] = field(default_factory=list)
    done: list[float] = field(default_factory=list)

    def add(self, moment: Moment) -> None:
        """Take pictures of a moment if it is time for them."""
        if len(self.done) == len(self.times) or moment.time < self.times[len(self.done)] or not moment.views:
            return
        if len(moment.views) < self.cameras and moment.time < self.times[len(self.done)] + 1.0:
            return
        self.done.append(moment.time)
        for number in range(len(moment.views)):
            self.overlays.append(points_in_image(moment, number))
            if self.limits is not None:
                self.besides.append(image_beside_features(moment, number, self.limits))


def times_between(start: float, end: float, count: int = MOMENTS) -> tuple[float, ...]:
    """Moments in the middle of as many equal pieces [s]."""
    return tuple(start + (end - start) * (2 * k + 1) / (2 * count) for k in range(count))


def points_in_image(moment: Moment, number: int) -> Picture:
    """One of a moment's images with the points of the scan that it shows."""
    image, projection = moment.images[number], moment.projection
    if projection is None:
        return image
    mine = projection.view == number
    return overlay(image, projection.pixel[mine], projection.distance[mine])


def image_beside_features(moment: Moment, number: int, limits: Float[np.ndarray, "2 3"]) -> Picture:
    """One of a moment's images and the first three components of its features (the paper's figure)."""
    grid = moment.views[number].camera.grid
    return beside(moment.images[number], colours(moment.features[number], limits), grid)


def contact_sheet(pictures: list[Picture], columns: int) -> Picture:
    """Pictures of any sizes in columns, scaled to one width and padded to one height."""
    width = WIDTH // columns
    scaled = [
        np.asarray(cv2.resize(p, (width, max(1, round(len(p) * width / p.shape[1]))), interpolation=cv2.INTER_AREA))
        for p in pictures
    ]
    tallest = max(len(p) for p in scaled)
    return sheet([np.pad(p, ((0, tallest - len(p)), (0, 0), (0, 0))) for p in scaled], columns=columns)
