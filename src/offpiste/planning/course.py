"""Where to drive: along a course (a path with speeds), or to a goal; each as layers of the cost map."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from offpiste.errors import PlanningError
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning.nearest_path_point import along_path

SHORTEST: Final = 0.01
"""Length of the shortest path that leads somewhere [m]."""


@dataclass(frozen=True)
class Course:
    """A path to drive along, with speeds.

    Attributes:
        path: x, y of points along it [m].
        speed: wanted at each of them [m/s].
        end: length of the path that is driven [m]; what lies beyond shows plans how it continues.

    Raises:
        PlanningError: the path leads nowhere.
    """

    path: Float[np.ndarray, "P 2"]
    speed: Float[np.ndarray, " P"]
    end: float = math.inf

    def __post_init__(self) -> None:
        if not np.linalg.norm(np.diff(self.path, axis=0), axis=-1).sum() > SHORTEST:
            how = f"give finite places, {SHORTEST} m of path at least; or a `Goal`"
            raise PlanningError(f"a path of {len(self.path)} points that leads nowhere", how=how)

    @property
    def driven(self) -> Float[np.ndarray, "_ 2"]:
        """The path without what lies beyond the end."""
        step = np.linalg.norm(np.diff(self.path, axis=0), axis=-1)
        return self.path[np.concatenate(([0.0], np.cumsum(step))) <= self.end]

    def densified(self, spacing: float) -> "Course":
        """The same course with a point every `spacing` [m], on straight lines between those given."""
        length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(self.path, axis=0), axis=-1))))
        at = np.linspace(0, length[-1], max(int(np.ceil(length[-1] / spacing)) + 1, 2))
        x, y = (np.interp(at, length, column) for column in self.path.T)
        return Course(np.stack((x, y), axis=-1), np.interp(at, length, self.speed), self.end)

    def layers(self, ground: TerrainLayers) -> Float32[np.ndarray, "ny nx 4"]:
        """Distance to the path, its direction and speed where it is nearest to each cell (to a quarter of a cell)."""
        dense = self.densified(spacing=ground.resolution / 2)
        step = np.gradient(dense.path, axis=0)
        direction = step / np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-9)
        values = np.concatenate((direction, dense.speed[:, None]), axis=-1, dtype=np.float32)
        return along_path(dense.path, values, ground.centres[0, :, 0], ground.centres[:, 0, 1])


@dataclass(frozen=True)
class Goal:
    """A place to go to, straight from everywhere, slowing down to stop there.

    Attributes:
        place: x, y in the world frame [m].
        speed: far from it [m/s].
        braking: deceleration near it [m/s^2]: v^2 = 2 braking distance.
    """

    place: Float[np.ndarray, " 2"]
    speed: float
    braking: float = 2.0

    def layers(self, ground: TerrainLayers) -> Float[np.ndarray, "ny nx 4"]:
        """Distance 0 (no place is off the way), direction to the goal and speed, as `Course.layers` has them."""
        there = self.place - ground.centres
        distance = np.linalg.norm(there, axis=-1)
        direction = there / np.maximum(distance, 1e-9)[..., None]
        wanted = np.minimum(self.speed, np.sqrt(2 * self.braking * distance))
        return np.concatenate((np.zeros_like(distance)[..., None], direction, wanted[..., None]), axis=-1)
