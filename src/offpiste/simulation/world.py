"""What a world is to everything that drives on it or looks at it: grids of nodes, trails and plants."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.conventions import GROUND_KINDS, GROUND_PROPERTIES

__all__ = ["GROUND_KINDS", "GROUND_PROPERTIES", "Bushes", "Trees", "World", "WorldSettings"]


@dataclass(frozen=True)
class WorldSettings:
    """What a world is made from; the same settings make the same world.

    Attributes:
        preset: name of a preset (`offpiste.simulation.presets`).
        seed: of everything random in it.
        grip_contrast: 1: ground as in grounds.toml; 0: all of it drives like the mean; between, in proportion.
        appearance_noise: how far light, shade, colour and texture vary for reasons that have nothing to do with grip.
        size: of the square [m].
        resolution: distance of the nodes [m].
    """

    preset: str = "mojave"
    seed: int = 0
    grip_contrast: float = 1.0
    appearance_noise: float = 1.0
    size: float = 320.0
    resolution: float = 0.25


@dataclass(frozen=True)
class Trees:
    """Obstacles.

    Attributes:
        foot: where the trunk leaves the ground, in the world frame [m].
        trunk_radius, crown_radius, height: [m].
    """

    foot: Float[np.ndarray, "n 3"]
    trunk_radius: Float[np.ndarray, " n"]
    crown_radius: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Bushes:
    """Plants that a vehicle can drive over at the price of a little drag.

    Attributes:
        foot: in the world frame [m].
        radius, height: [m].
        drag: force on a vehicle that drives through [N].
    """

    foot: Float[np.ndarray, "n 3"]
    radius: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    drag: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class World:
    """A square of ground. Node [j, i] of a grid lies at (origin[0] + i resolution, origin[1] + j resolution).

    Attributes:
        origin: x, y of node [0, 0] in the world frame [m].
        resolution: distance of the nodes [m].
        elevation: [m].
        kinds: share of each of `GROUND_KINDS`; sums to 1.
        wetness: 0 dry ... 1 wet.
        properties: of `GROUND_PROPERTIES`, mixed from kinds and wetness, contrast applied.
        grass_height: of tall grass, 0 where there is none [m].
        trails: centre lines, in the order of driving [m].
    """

    settings: WorldSettings
    origin: tuple[float, float]
    resolution: float
    elevation: Float[np.ndarray, "ny nx"]
    kinds: Float[np.ndarray, "K ny nx"]
    wetness: Float[np.ndarray, "ny nx"]
    properties: Float[np.ndarray, "ny nx 4"]
    grass_height: Float[np.ndarray, "ny nx"]
    trees: Trees
    bushes: Bushes
    trails: tuple[Float[np.ndarray, "_ 2"], ...]
