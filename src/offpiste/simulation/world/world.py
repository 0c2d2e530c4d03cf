"""A world as the vehicle, its driver and its sensors know it: grids of nodes, trails and plants."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class WorldSettings:
    """Settings of a world; the same settings make the same world.

    Attributes:
        preset: a world's name (`preset.WORLDS`), or the path of a TOML file.
        seed: seed of everything random in it.
        grip_contrast: 1: ground as in grounds.toml; 0: all of it drives like the mean; between, in proportion.
        appearance_noise: how far light, shade, colour and texture vary for reasons that have nothing to do with grip.
        size: side of the square [m].
        resolution: distance between nodes [m].
    """

    preset: str = "mojave"
    seed: int = 0
    grip_contrast: float = 1.0
    appearance_noise: float = 1.0
    size: float = 320.0
    resolution: float = 0.25

    @property
    def name(self) -> str:
        """The world's name: that of its preset, or its file's without folder and suffix."""
        return Path(self.preset).stem if self.preset.endswith(".toml") else self.preset


@dataclass(frozen=True)
class Trees:
    """Trees: obstacles.

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
    """Bushes: plants that a vehicle can drive through with a little drag.

    Attributes:
        foot: where they stand, in the world frame [m].
        radius, height: [m].
        drag: force on a vehicle that drives through one [N].
    """

    foot: Float[np.ndarray, "n 3"]
    radius: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    drag: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class World:
    """A square of ground; node [j, i] of its grids lies at (origin[0] + i resolution, origin[1] + j resolution).

    Attributes:
        origin: x, y of node [0, 0] in the world frame [m].
        resolution: distance between nodes [m].
        elevation: height of the ground [m].
        kinds: share of each of `logs.ground_truth.GROUND_KINDS`; they sum to 1.
        wetness: 0 dry ... 1 wet.
        properties: values of `logs.ground_truth.GROUND_PROPERTIES`, mixed from kinds and wetness, contrast applied.
        grass_height: height of tall grass, 0 where there is none [m].
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
