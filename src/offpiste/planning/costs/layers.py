"""Cost map: the declaration of its layers, and the layers of offpiste (hazard, speed limit, course)."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from offpiste.core.errors import PlanningError
from offpiste.core.registry import Registry
from offpiste.mapping.terrain_map import TerrainLayers, on_map
from offpiste.mapping.voxels_to_layers import neighbour_offsets
from offpiste.planning.course import Course, Goal

Reading = Literal["mean of wheels", "least of wheels", "pose point"]
"""Cells at which terms read a layer: those nearest to the wheels or to the pose point."""


@dataclass(frozen=True)
class Hazards:
    """Costs of the ground under a wheel.

    Attributes:
        obstacle: cost of cells within `margin` of obstacles higher than `height` [1/s].
        height: minimum height of obstacles [m].
        low: factor on that cost near obstacles lower than `tall`.
        tall: height from which obstacles count in full [m].
        margin: distance around the centres of wheels; half the track also covers the space between the wheels [m].
        unknown: cost of unknown cells and off the map [1/s].
        steep: cost per rise over run above `steepest` [1/s].
        steepest: slope without cost [m per m].
        bump: accepted vertical acceleration [m/s^2].
        bump_length: assumed wavelength of bumps [m].
    """

    obstacle: float = 200.0
    height: float = 0.25
    low: float = 1.0
    tall: float = 1.5
    margin: float = 0.8
    unknown: float = 5.0
    steep: float = 200.0
    steepest: float = 0.45
    bump: float = 6.0
    bump_length: float = 3.0


@dataclass(frozen=True)
class CostLayer:
    """A layer of the cost map.

    Attributes:
        name: name of the argument by which terms read it.
        outside: value off the map, or a function of the settings that returns it; None for that of the nearest cell.
    """

    name: str
    unit: str
    read: Reading
    outside: float | Callable[[Hazards], float] | None = None


@dataclass(frozen=True)
class LayerSource:
    """Layers computed together.

    Attributes:
        compute: function of any of `ground`, `course` and `hazards`; returns [ny, nx], or [ny, nx, C] for several
            layers, without NaN.
    """

    layers: tuple[CostLayer, ...]
    compute: Callable[..., np.ndarray]


SOURCES: Final[Registry[LayerSource]] = Registry("cost layer", package="offpiste.planning.costs", error=PlanningError)


def cost_layer(*layers: CostLayer) -> Callable[[Callable[..., np.ndarray]], Callable[..., np.ndarray]]:
    """Declare the layers that the decorated function computes.

    Raises:
        PlanningError: the name of a layer is taken.
    """

    def declare(compute: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
        for layer in layers:
            SOURCES.register(layer.name)(LayerSource(layers, compute))
        return compute

    return declare


@dataclass(frozen=True)
class CostMap:
    """Layers at cell centres; row j lies at y = origin[1] + j resolution, column i at x = origin[0] + i resolution.

    Attributes:
        origin: centre of cell [0, 0] in the world frame [m] (float64).
        resolution: cell size [m].
        layers: without NaN; speed limits may be infinite.
        outside: value of each layer off the map; NaN for that of the nearest cell.
        table: declarations of the layers.
    """

    origin: Float[Tensor, " 2"]
    resolution: float
    layers: Float[Tensor, "ny nx C"]
    outside: tuple[float, ...]
    table: tuple[CostLayer, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the layers."""
        return tuple(layer.name for layer in self.table)

    def at(self, place: Float[Tensor, "*P 2"], offset: Float[Tensor, " 2"]) -> Float[Tensor, "*P C"]:
        """Return the values of the nearest cell, or those of `outside` off the map.

        Layers read at the pose point are NaN for non-finite places.

        Args:
            place: x, y [m].
            offset: origin of the frame of `place` in the world frame [m] (float64).
        """
        ny, nx, _ = self.layers.shape
        cell = (place + (offset - self.origin).to(place.dtype)) * (1 / self.resolution)
        limit = cell.new_tensor([nx - 1, ny - 1])
        inside = on_map(cell[..., 0], cell[..., 1], nx - 1, ny - 1, 0.5)
        nearest = torch.minimum(cell.nan_to_num().clamp(min=0), limit).round().long()
        values = self.layers[nearest[..., 1], nearest[..., 0]].to(place.dtype)
        for column, (layer, outside) in enumerate(zip(self.table, self.outside, strict=True)):
            if not math.isnan(outside):
                values[..., column] = torch.where(inside, values[..., column], outside)
            if layer.read == "pose point":
                values[..., column] += (place - place).sum(dim=-1)
        return values


def cost_map(ground: TerrainLayers, course: Course | Goal, hazards: Hazards) -> CostMap:
    """Return the cost map of all declared layers, on the grid of the terrain map."""
    inputs = {"ground": ground, "course": course, "hazards": hazards}
    sources, layers = layer_sources(), []
    for source in sources:
        computed = source.compute(**{name: inputs[name] for name in inspect.signature(source.compute).parameters})
        layers.append(computed.reshape(*computed.shape[:2], len(source.layers)))
    table = tuple(layer for source in sources for layer in source.layers)
    return CostMap(
        torch.as_tensor(ground.origin, dtype=torch.float64),
        ground.resolution,
        torch.from_numpy(np.concatenate(layers, -1, dtype=np.float32)),
        tuple(_outside(layer, hazards) for layer in table),
        table,
    )


def _outside(layer: CostLayer, hazards: Hazards) -> float:
    if layer.outside is None:
        return math.nan
    return layer.outside(hazards) if callable(layer.outside) else layer.outside


def layer_sources() -> list[LayerSource]:
    """Return the sources of layers, those of offpiste first, others by name."""

    def place(entry: tuple[str, LayerSource]) -> tuple[bool, str]:
        name, source = entry
        ships = source.compute.__module__.startswith("offpiste.")
        return not ships, "" if ships else name

    return list({id(source.compute): source for _, source in sorted(SOURCES.items(), key=place)}.values())


@cost_layer(
    CostLayer("hazard", "1/s", "mean of wheels", lambda hazards: hazards.unknown),
    CostLayer("speed_limit", "m/s", "least of wheels", math.inf),
)
def hazard_layers(ground: TerrainLayers, hazards: Hazards) -> Float[np.ndarray, "ny nx 2"]:
    """Compute hazard [1/s] and speed limit [m/s] of cells."""
    # Comparisons and `fmax` ignore NaN.
    margin = hazards.margin / ground.resolution
    near = _widened(ground.obstacle_height > hazards.height, margin)
    tall = _widened(ground.obstacle_height >= max(hazards.tall, hazards.height), margin)
    steep = hazards.steep * np.fmax(ground.slope - hazards.steepest, 0)
    obstacle = np.where(tall, hazards.obstacle, np.where(near, hazards.low * hazards.obstacle, 0))
    hazard = obstacle + steep + np.where(ground.known, 0, hazards.unknown)
    limit = speed_limit(ground.roughness, hazards.bump, hazards.bump_length)
    return np.stack((hazard, limit), axis=-1)


@cost_layer(
    CostLayer("distance", "m", "pose point"),
    CostLayer("direction_x", "1", "pose point"),
    CostLayer("direction_y", "1", "pose point"),
    CostLayer("target_speed", "m/s", "pose point"),
)
def course_layers(ground: TerrainLayers, course: Course | Goal) -> Float[np.ndarray, "ny nx 4"]:
    """Compute the distance to the course, its direction (a unit vector) and its speed."""
    return course.layers(ground)


def speed_limit(roughness: Float[np.ndarray, "*P"], acceleration: float, wavelength: float) -> Float[np.ndarray, "*P"]:
    """Return the speed at which a wheel on a sine of this root mean square reaches a vertical acceleration [m/s].

    sqrt(2) roughness (2 pi v / wavelength)^2 = acceleration. Infinite for roughness 0 or NaN [m].
    """
    amplitude = math.sqrt(2) * np.fmax(roughness, 0)
    with np.errstate(divide="ignore"):
        return wavelength / (2 * math.pi) * np.sqrt(acceleration / amplitude)


def _widened(cells: Bool[np.ndarray, "ny nx"], radius: float) -> Bool[np.ndarray, "ny nx"]:
    """Dilate cells by a radius [cells]."""
    offsets = neighbour_offsets(radius)
    disc = np.zeros(2 * offsets.max(axis=0) + 1, np.uint8)
    disc[tuple((offsets + offsets.max(axis=0)).T)] = 1
    return cv2.dilate(cells.astype(np.uint8), disc).astype(bool)
