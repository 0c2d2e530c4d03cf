"""What the point of a path has that is nearest, for each cell of a grid.

What the cost of driving reads at a place: hazards and speed limits of the ground, and the course, as one raster.
"""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from offpiste.compilation import PLANNING
from offpiste.errors import PlanningError
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.mapping.voxels_to_layers import neighbour_offsets
from offpiste.threads import spread_kernel

BLOCK = 4
"""Cells to a side, far from the path, that share their nearest point of it."""

NEAR = 6
"""Blocks nearer than as many sides to the path are not far. There a point half a diagonal beside the nearest is 0.17
cells further; where another bend is as near, less than a diagonal."""

STRIDE = 8
"""Of as many points one is looked at first."""


def along_path(
    path: Float[np.ndarray, "P 2"],
    values: Float32[np.ndarray, "P V"],
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
) -> Float32[np.ndarray, "ny nx 1+V"]:
    """How far the nearest point of a path is [m], and its values: from the middle of blocks, and near the path exactly.

    Args:
        path: two points at least; quick where they are evenly spaced.
        x, y: of the columns and rows of cells, evenly spaced [m].
    """
    found = np.empty((len(y), len(x), 1 + values.shape[1]), np.float32)
    slack = STRIDE * float(np.linalg.norm(np.diff(path, axis=0), axis=1).max())
    resolution = float(x[1] - x[0]) if len(x) > 1 else 0.0
    spread_kernel(-(-len(y) // BLOCK), _fill, np.ascontiguousarray(path), values, slack, x, y, resolution, found)
    return found


@PLANNING.inlined
def _nearest(px: float, py: float, path: np.ndarray, begin: int, end: int, stride: int) -> tuple[int, float]:
    """The nearest of every `stride`-th point, and its squared distance."""
    best, least = begin, np.inf
    for k in range(begin, end, stride):
        dx, dy = path[k, 0] - px, path[k, 1] - py
        squared = dx * dx + dy * dy
        if squared < least:
            best, least = k, squared
    return best, least


@PLANNING.inlined
def _within(px: float, py: float, path: np.ndarray, reach: float) -> tuple[int, int]:
    """From the first to behind the last of the strides that begin within reach."""
    begin, end = len(path), 0
    for k in range(0, len(path), STRIDE):
        dx, dy = path[k, 0] - px, path[k, 1] - py
        if dx * dx + dy * dy <= reach * reach:
            begin, end = min(begin, k), k + STRIDE
    return begin, min(end, len(path))


@PLANNING.entry
def _fill(
    first: int,
    last: int,
    path: np.ndarray,
    values: np.ndarray,
    slack: float,
    x: np.ndarray,
    y: np.ndarray,
    resolution: float,
    found: np.ndarray,
) -> None:
    """Rows of blocks `first` ... `last - 1`; `slack`: points are no further from where their stride begins."""
    half = (BLOCK - 1) / 2 * resolution
    for row in range(first, last):
        for column in range(0, len(x), BLOCK):
            px, py = x[column] + half, y[row * BLOCK] + half
            away = np.sqrt(_nearest(px, py, path, 0, len(path), STRIDE)[1])
            near = away < NEAR * BLOCK * resolution
            # A cell lies up to sqrt(2) half beside the middle, and what is nearest to it as far again.
            begin, end = _within(px, py, path, away + slack + (3 * half if near else 0.0))
            best, _ = _nearest(px, py, path, begin, end, 1)
            for j in range(row * BLOCK, min((row + 1) * BLOCK, len(y))):
                for i in range(column, min(column + BLOCK, len(x))):
                    if near:
                        best, squared = _nearest(x[i], y[j], path, begin, end, 1)
                    else:
                        squared = (path[best, 0] - x[i]) ** 2 + (path[best, 1] - y[j]) ** 2
                    found[j, i, 0] = np.sqrt(squared)
                    for v in range(values.shape[1]):
                        found[j, i, 1 + v] = values[best, v]


SHORTEST: Final = 0.01
"""Of a path [m]."""

LAYERS: Final = ("hazard", "speed_limit", "distance", "direction_x", "direction_y", "target_speed")
"""Cost of a wheel [1/s]; [m/s]; to the path [m]; along it, a unit vector; along it [m/s]."""


@dataclass(frozen=True)
class Hazards:
    """How dear the ground is under a wheel.

    Attributes:
        obstacle: cost [1/s] of cells within `margin` of anything higher than `height`.
        height: [m].
        margin: of the wheels' centres; half the track covers what lies between the wheels [m].
        unknown: cost of cells of which nothing is known, and off the map [1/s].
        steep: cost per rise over run above `steepest` [1/s].
        steepest: [m per m].
        bump: vertical acceleration that is accepted [m/s^2].
        bump_length: wavelength of the bumps that roughness is made of [m].
    """

    obstacle: float = 200.0
    height: float = 0.25
    margin: float = 0.8
    unknown: float = 5.0
    steep: float = 200.0
    steepest: float = 0.45
    bump: float = 6.0
    bump_length: float = 3.0


@dataclass(frozen=True)
class Goal:
    """Where to go, whichever way: everywhere straight to it, slowing down to stop there.

    Attributes:
        place: x, y in the world frame [m].
        speed: far from it [m/s].
        braking: deceleration near it [m/s^2]: v^2 = 2 braking distance.
    """

    place: Float[np.ndarray, " 2"]
    speed: float
    braking: float = 2.0


@dataclass(frozen=True)
class Course:
    """Where to go along a path.

    Attributes:
        path: x, y of points along it [m].
        speed: wanted at each of them [m/s].
        end: so far along the path the course is driven [m]; what lies beyond tells plans how it goes on.

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


@dataclass(frozen=True)
class CostMap:
    """`LAYERS` at cell centres; row j lies at y = origin[1] + j resolution, column i alike in x.

    Attributes:
        origin: of cell [0, 0] in the world frame [m] (float64).
        resolution: size of a cell [m].
        layers: never NaN; speed limits may be infinite.
        outside: the hazard off the map [1/s].
    """

    origin: Float[Tensor, " 2"]
    resolution: float
    layers: Float[Tensor, "ny nx 6"]
    outside: float

    def at(self, place: Float[Tensor, "*P 2"], offset: Float[Tensor, " 2"]) -> Float[Tensor, "*P 6"]:
        """Layers of the nearest cell; off the map those of its border, but for the hazard and no speed limit.

        The distance is NaN where the place is not finite.

        Args:
            place: x, y [m].
            offset: of the frame of `place` in the world frame [m] (float64).
        """
        ny, nx, _ = self.layers.shape
        cell = (place + (offset - self.origin).to(place.dtype)) * (1 / self.resolution)
        limit = cell.new_tensor([nx - 1, ny - 1])
        inside = ((cell > -0.5) & (cell < limit + 0.5)).all(dim=-1)
        nearest = torch.minimum(cell.nan_to_num().clamp(min=0), limit).round().long()
        found = self.layers[nearest[..., 1], nearest[..., 0]].to(place.dtype)
        found[..., 0] = torch.where(inside, found[..., 0], self.outside)
        found[..., 1] = torch.where(inside, found[..., 1], torch.inf)
        found[..., 2] += (place - place).sum(dim=-1)
        return found


def cost_map(ground: TerrainLayers, course: Course | Goal, hazards: Hazards) -> CostMap:
    """The raster of a map and a course or a goal, on the map's grid."""
    wanted = goal_layers(ground, course) if isinstance(course, Goal) else course_layers(ground, course)
    layers = np.concatenate((hazard_layers(ground, hazards), wanted), -1, dtype=np.float32)
    return CostMap(
        torch.as_tensor(ground.origin, dtype=torch.float64),
        ground.resolution,
        torch.from_numpy(layers),
        hazards.unknown,
    )


def hazard_layers(ground: TerrainLayers, hazards: Hazards) -> Float[np.ndarray, "ny nx 2"]:
    """Hazard [1/s] and speed limit [m/s] of cells."""
    # Comparisons and `fmax` pass over what is not a number.
    near = _widened(ground.obstacle_height > hazards.height, hazards.margin / ground.resolution)
    steep = hazards.steep * np.fmax(ground.slope - hazards.steepest, 0)
    hazard = np.where(near, hazards.obstacle, 0) + steep + np.where(ground.known, 0, hazards.unknown)
    limit = speed_limit(ground.roughness, hazards.bump, hazards.bump_length)
    return np.stack((hazard, limit), axis=-1)


def speed_limit(roughness: Float[np.ndarray, "*P"], acceleration: float, wavelength: float) -> Float[np.ndarray, "*P"]:
    """The speed at which a wheel on a sine of this root mean square has this vertical acceleration at its peaks.

    sqrt(2) roughness (2 pi v / wavelength)^2 = acceleration. Infinite on smooth ground and where roughness is unknown.

    Args:
        roughness: root mean square [m].
        acceleration: [m/s^2].
        wavelength: [m].
    """
    amplitude = math.sqrt(2) * np.fmax(roughness, 0)
    with np.errstate(divide="ignore"):
        return wavelength / (2 * math.pi) * np.sqrt(acceleration / amplitude)


def _widened(cells: Bool[np.ndarray, "ny nx"], radius: float) -> Bool[np.ndarray, "ny nx"]:
    """Cells whose centres lie within a radius of one of those given [cells]."""
    offsets = neighbour_offsets(radius)
    disc = np.zeros(2 * offsets.max(axis=0) + 1, np.uint8)
    disc[tuple((offsets + offsets.max(axis=0)).T)] = 1
    return cv2.dilate(cells.astype(np.uint8), disc).astype(bool)


def course_layers(ground: TerrainLayers, course: Course) -> Float32[np.ndarray, "ny nx 4"]:
    """Distance to the path, its direction and its speed where it is nearest to each cell (to a quarter of a cell)."""
    dense = densified(course, spacing=ground.resolution / 2)
    step = np.gradient(dense.path, axis=0)
    direction = step / np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-9)
    values = np.concatenate((direction, dense.speed[:, None]), axis=-1, dtype=np.float32)
    return along_path(dense.path, values, ground.centres[0, :, 0], ground.centres[:, 0, 1])


def densified(course: Course, spacing: float) -> Course:
    """The same course with a point every `spacing` [m], straight between those given."""
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(course.path, axis=0), axis=-1))))
    at = np.linspace(0, length[-1], max(int(np.ceil(length[-1] / spacing)) + 1, 2))
    x, y = (np.interp(at, length, column) for column in course.path.T)
    return Course(np.stack((x, y), axis=-1), np.interp(at, length, course.speed), course.end)


def goal_layers(ground: TerrainLayers, goal: Goal) -> Float[np.ndarray, "ny nx 4"]:
    """Layers like those of a path; no place is off it."""
    there = goal.place - ground.centres
    distance = np.linalg.norm(there, axis=-1)
    direction = there / np.maximum(distance, 1e-9)[..., None]
    wanted = np.minimum(goal.speed, np.sqrt(2 * goal.braking * distance))
    return np.concatenate((np.zeros_like(distance)[..., None], direction, wanted[..., None]), axis=-1)
