"""Ground as a mesh of triangles, in tiles at fixed places in the world."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.mapping.terrain_map import TerrainLayers

TILE: Final = 100
"""Number of cells along the side of a tile: 20 m of a map of 0.2 m."""


@dataclass(frozen=True)
class Tile:
    """Tile of a map.

    Attributes:
        place: x and y of the tile, in tiles.
        rows, columns: of the map, in steps, with one more at the upper ends so that tiles meet.
    """

    place: tuple[int, int]
    rows: slice
    columns: slice


def tiles(layers: TerrainLayers, step: int) -> Iterator[Tile]:
    """The tiles that a map covers, at least in part.

    Args:
        step: every so many cells is taken, the same ones wherever the map is; divides `TILE`.
    """
    low = np.floor(layers.origin / layers.resolution).astype(int).tolist()  # cell i covers [i, i + 1) cells
    ny, nx = layers.known.shape
    for y in range(low[1] // TILE, (low[1] + ny - 1) // TILE + 1):
        for x in range(low[0] // TILE, (low[0] + nx - 1) // TILE + 1):
            yield Tile((x, y), _between(y, low[1], ny, step), _between(x, low[0], nx, step))


def grid_triangles(known: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "T 3"]:
    """Two triangles, counter-clockwise from above, a square of four known cells; numbers count known cells only."""
    number = np.where(known, np.cumsum(known).reshape(known.shape) - 1, -1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    lower, upper = np.stack((a, b, d), axis=-1)[whole], np.stack((a, d, c), axis=-1)[whole]
    return np.concatenate((lower, upper))


def cell_centres(layers: TerrainLayers, tile: Tile) -> Float[np.ndarray, "h w 3"]:
    """Places of a tile's cells on the ground [m]."""
    ny, nx = layers.known.shape
    x = layers.origin[0] + layers.resolution * np.arange(nx)[tile.columns]
    y = layers.origin[1] + layers.resolution * np.arange(ny)[tile.rows]
    xx, yy = np.meshgrid(x, y)
    return np.stack((xx, yy, layers.elevation[tile.rows, tile.columns]), axis=-1)


def _between(tile: int, low: int, count: int, step: int) -> slice:
    first = max(tile * TILE, low)
    first += -first % step
    return slice(first - low, min((tile + 1) * TILE + 1, low + count) - low, step)
