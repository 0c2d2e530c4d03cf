"""Camera images with what was found in them, from a few moments of a drive."""

from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from offpiste.mapping.replay import Moment
from offpiste.perception.overlay import overlay
from offpiste.perception.pictures import beside, colours, sheet

MOMENTS: Final = 4
"""That are shown of a drive."""

WIDTH: Final = 2000
"""Of a sheet [px]."""

Picture = UInt8[np.ndarray, "_ _ 3"]


@dataclass(frozen=True)
class Album:
    """Pictures of the first moments after given times at which all cameras that speak have been looked through.

    Attributes:
        times: rising [s].
        limits: colours of the features; None without features.
        cameras: as many are waited for, up to a second.
        overlays: image by image: points in it, red near and blue far.
        besides: the same image beside its features.
    """

    times: tuple[float, ...]
    limits: Float[np.ndarray, "2 3"] | None
    cameras: int
    overlays: list[Picture] = field(default_factory=list)
    besides: list[Picture] = field(default_factory=list)
    done: list[float] = field(default_factory=list)

    def look(self, moment: Moment) -> None:
        """Take a picture if it is time for one."""
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
    return beside(moment.images[number], colours(moment.looks[number], limits), grid)


def contact_sheet(pictures: list[Picture], columns: int) -> Picture:
    """Pictures of any sizes in columns, scaled to one width and padded to one height."""
    width = WIDTH // columns
    scaled = [
        np.asarray(cv2.resize(p, (width, max(1, round(len(p) * width / p.shape[1]))), interpolation=cv2.INTER_AREA))
        for p in pictures
    ]
    tallest = max(len(p) for p in scaled)
    return sheet([np.pad(p, ((0, tallest - len(p)), (0, 0), (0, 0))) for p in scaled], columns=columns)
