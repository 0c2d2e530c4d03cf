"""Layers of the cost map: how one is declared, and those that ship (hazard, speed limit, course)."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.errors import PlanningError
from offpiste.core.registry import Registry
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.mapping.voxels_to_layers import neighbour_offsets
from offpiste.planning.course import Course, Goal

Reading = Literal["mean of wheels", "least of wheels", "pose point"]
"""Where terms read a layer: at the nearest cell of each wheel, or of the pose point."""


@dataclass(frozen=True)
class Hazards:
    """How expensive the ground is under a wheel.

    Attributes:
        obstacle: cost of cells within `margin` of anything higher than `height` [1/s].
        height: [m].
        low: share of that cost that counts near obstacles that are all lower than `tall`.
        tall: height from which obstacles count in full [m].
        margin: around the wheels' centres; half the track covers what lies between the wheels [m].
        unknown: cost of cells of which nothing is known, and off the map [1/s].
        steep: cost per rise over run above `steepest` [1/s].
        steepest: [m per m].
        bump: vertical acceleration that is accepted [m/s^2].
        bump_length: wavelength of the bumps that roughness is made of [m].
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
        name: under which terms read it.
        unit: of its numbers.
        read: where.
        outside: its number off the map, or that number from the settings; None: that of the nearest cell.
    """

    name: str
    unit: str
    read: Reading
    outside: float | Callable[[Hazards], float] | None = None


@dataclass(frozen=True)
class LayerSource:
    """Layers that are computed together.

    Attributes:
        compute: from the arguments that it names (`ground`, `course`, `hazards`) to [ny, nx], or [ny, nx, C] for
            several layers; never NaN.
    """

    layers: tuple[CostLayer, ...]
    compute: Callable[..., np.ndarray]


SOURCES: Final[Registry[LayerSource]] = Registry("cost layer", package="offpiste.planning.costs", error=PlanningError)


def cost_layer(*layers: CostLayer) -> Callable[[Callable[..., np.ndarray]], Callable[..., np.ndarray]]:
    """Declare layers of the cost map: decorates the function that computes them.

    Raises:
        PlanningError: a layer of that name is there already.
    """

    def declare(compute: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
        for layer in layers:
            SOURCES.register(layer.name)(LayerSource(layers, compute))
        return compute

    return declare


def layer_sources() -> list[LayerSource]:
    """What computes the layers, each once: those that ship first, then others by name."""

    def place(entry: tuple[str, LayerSource]) -> tuple[bool, str]:
        name, source = entry
        ships = source.compute.__module__.startswith("offpiste.")
        return not ships, "" if ships else name

    return list({id(source.compute): source for _, source in sorted(SOURCES.items(), key=place)}.values())


def computed(source: LayerSource, inputs: dict[str, Any]) -> Float[np.ndarray, "ny nx C"]:
    """Layers of a source, from the inputs that its function names."""
    result = source.compute(**{name: inputs[name] for name in inspect.signature(source.compute).parameters})
    return result.reshape(*result.shape[:2], len(source.layers))


@cost_layer(
    CostLayer("hazard", "1/s", "mean of wheels", lambda hazards: hazards.unknown),
    CostLayer("speed_limit", "m/s", "least of wheels", math.inf),
)
def hazard_layers(ground: TerrainLayers, hazards: Hazards) -> Float[np.ndarray, "ny nx 2"]:
    """Hazard [1/s] and speed limit [m/s] of cells."""
    # Comparisons and `fmax` pass over what is not a number.
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
    """Distance to the course, its direction (a unit vector) and its speed at each cell."""
    return course.layers(ground)


def speed_limit(roughness: Float[np.ndarray, "*P"], acceleration: float, wavelength: float) -> Float[np.ndarray, "*P"]:
    """Speed at which a wheel on a sine of this root mean square has this vertical acceleration at its peaks [m/s].

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
