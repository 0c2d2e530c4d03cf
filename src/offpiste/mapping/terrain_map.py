"""Terrain map: layers on a world-aligned grid, indices of its cells, and wheel positions.

`on_map` and `bilinear` are plain arithmetic on numbers or arrays, in cell coordinates: cell [j, i] has its centre at
x = i, y = j.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

Number = Any  # float, NumPy array or tensor; constants are arguments so that float32 stays float32


def on_map(x: Number, y: Number, last_x: Number, last_y: Number, half: Number) -> Number:
    """Return whether a point is nearest to a cell of the map; false for NaN.

    Args:
        last_x, last_y: coordinates of the last column and row.
        half: 0.5.
    """
    return (x > -half) & (x < last_x + half) & (y > -half) & (y < last_y + half)


def bilinear(v00: Number, v01: Number, v10: Number, v11: Number, u: Number, v: Number, one: Number) -> Number:
    """Interpolate between four cells v[row][column]; NaN if one of them is.

    Args:
        u, v: distance from the first column and row, 0 to 1.
        one: 1.
    """
    return (v00 * (one - u) + v01 * u) * (one - v) + (v10 * (one - u) + v11 * u) * v


def wheel_position(px: Number, py: Number, cos: Number, sin: Number, x: Number, y: Number) -> tuple[Number, Number]:
    """Return the horizontal position of a wheel [m].

    Args:
        px, py: position of the pose point [m].
        cos, sin: cosine and sine of the yaw.
        x, y: position of the wheel in the body frame, from the pose point [m].
    """
    return px + cos * x - sin * y, py + sin * x + cos * y


def wheel_positions(
    xy: Float[np.ndarray, "N 2"], yaw: Float[np.ndarray, " N"], wheels: Float[np.ndarray, "4 2"]
) -> Float[np.ndarray, "N 4 2"]:
    """Return the horizontal positions of the wheels in the frame of the poses [m].

    Args:
        xy, yaw: pose of the pose point [m, rad].
        wheels: positions in the body frame, from the pose point (`Rig.wheel_positions`) [m].
    """
    x, y = wheels.T
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    return np.stack(wheel_position(xy[:, :1], xy[:, 1:], cos, sin, x, y), axis=-1)


def wheel_positions_of_states(state: Float[Tensor, "*B 6"], wheels: Float[Tensor, "4 2"]) -> Float[Tensor, "*B 4 2"]:
    """Return the wheel positions for states (`conventions.STATE`), as tensors of their type."""
    px, py, yaw = (column[..., None] for column in state[..., :3].unbind(dim=-1))
    x, y = wheels.to(state.dtype).unbind(dim=-1)
    return torch.stack(wheel_position(px, py, torch.cos(yaw), torch.sin(yaw), x, y), dim=-1)


@dataclass(frozen=True)
class TerrainMap:
    """Elevation and features of ground cells; NaN where nothing is known."""

    origin: Float[np.ndarray, " 2"]  # x, y of the centre of cell [0, 0] in the world frame [m]
    resolution: float  # size of a cell [m]
    # row j lies at y = origin[1] + j resolution, column i at x = origin[0] + i resolution [m]
    elevation: Float[np.ndarray, "ny nx"]
    features: Float[np.ndarray, "ny nx F"]  # all NaN where missing
    # rise towards +x and +y at cell centres, where known better than from the elevation of neighbours [m/m]
    rise: Float[np.ndarray, "ny nx 2"] | None = None

    def cropped(self, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> "TerrainMap":
        """Return the cells whose centres lie in a box of the world frame, with a border of one cell."""
        window, origin = _window(self, low, high)
        rise = None if self.rise is None else self.rise[window]
        return TerrainMap(origin, self.resolution, self.elevation[window], self.features[window], rise)


def _layer(*components: int, dtype: type = np.float32) -> dict[str, Any]:
    """Declare a layer [ny, nx, *components], NaN or false where unknown."""
    return {"components": components, "dtype": dtype}


CHANNELS: Final = -1  # placeholder for the number of features


@dataclass(frozen=True)
class TerrainLayers:
    """Layers of the ground around the vehicle; row j lies at y = origin[1] + j resolution, column i alike in x.

    Memory and crops follow from these declarations; `infill.write_layers` writes the values.
    """

    origin: Float[np.ndarray, " 2"]  # x, y of the centre of cell [0, 0] in the world frame [m]
    resolution: float  # size of a cell [m]
    # height of the ground at the cell's centre [m]; NaN where not `known`
    elevation: Float[np.ndarray, "ny nx"] = field(metadata=_layer(dtype=np.float64))
    # upward unit normal in the world frame; NaN where too few points define a plane
    normal: Float[np.ndarray, "ny nx 3"] = field(metadata=_layer(3))
    slope: Float[np.ndarray, "ny nx"] = field(metadata=_layer())  # rise over run, 1 at 45 degrees; NaN without a normal
    # root mean square vertical distance of the ground from its planes [m]; NaN without a normal
    roughness: Float[np.ndarray, "ny nx"] = field(metadata=_layer())
    # height over the ground of the highest thing that a vehicle would hit, excluding things above the vehicle's height
    # [m]; NaN where not `known`
    obstacle_height: Float[np.ndarray, "ny nx"] = field(metadata=_layer())
    # visual terrain features; NaN where not `valid`
    features: Float[np.ndarray, "ny nx F"] = field(metadata=_layer(CHANNELS))
    # sensor distance of the features [m]; NaN where not `valid`
    distance: Float[np.ndarray, "ny nx"] = field(metadata=_layer())
    # cell has ground, observed or filled from a cell nearby
    known: Bool[np.ndarray, "ny nx"] = field(metadata=_layer(dtype=bool))
    observed: Bool[np.ndarray, "ny nx"] = field(metadata=_layer(dtype=bool))  # cell itself was hit
    valid: Bool[np.ndarray, "ny nx"] = field(metadata=_layer(dtype=bool))  # cell has features

    @property
    def centres(self) -> Float[np.ndarray, "ny nx 2"]:
        """World positions x, y of the cells' centres [m]."""
        ny, nx = self.known.shape
        x = self.origin[0] + self.resolution * np.arange(nx)
        y = self.origin[1] + self.resolution * np.arange(ny)
        return np.stack(np.meshgrid(x, y), axis=-1)

    def cropped(self, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> "TerrainLayers":
        """Return the cells whose centres lie in a box, with a border of one cell or the nearest; shares memory."""
        window, origin = _window(self, low, high)
        return replace(self, origin=origin, **{layer.name: getattr(self, layer.name)[window] for layer in LAYERS})

    def terrain_map(self) -> TerrainMap:
        """Return the map that models sample; shares memory with the layers where possible."""
        with np.errstate(invalid="ignore"):
            rise = -self.normal[..., :2] / self.normal[..., 2:]
        return TerrainMap(self.origin, self.resolution, self.elevation, self.features, rise)


def _window(
    ground: TerrainMap | TerrainLayers, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]
) -> tuple[tuple[slice, slice], Float[np.ndarray, " 2"]]:
    """Return row and column slices of a box with a border of one cell, and their origin."""
    ny, nx = ground.elevation.shape
    first = np.clip(np.floor((low - ground.origin) / ground.resolution).astype(int), 0, [nx - 1, ny - 1])
    last = np.clip(np.ceil((high - ground.origin) / ground.resolution).astype(int), first, [nx - 1, ny - 1])
    rows, columns = slice(first[1], last[1] + 1), slice(first[0], last[0] + 1)
    return (rows, columns), ground.origin + first * ground.resolution


LAYERS: Final = tuple(f for f in fields(TerrainLayers) if f.metadata)  # declared layers in order


def empty_layers(cells: int, channels: int) -> TerrainLayers:
    """Return unknown layers [cells, cells] with `channels` features."""
    every = {layer.name: nothing_known(layer.name, (cells, cells), channels) for layer in LAYERS}
    return TerrainLayers(np.zeros(2), 1.0, **every)


def nothing_known(layer: str, shape: tuple[int, ...], channels: int) -> np.ndarray:
    """Return the values of a layer for unknown cells of any shape."""
    (declared,) = (each.metadata for each in LAYERS if each.name == layer)
    dtype, components = declared["dtype"], declared["components"]
    more = tuple(channels if size == CHANNELS else size for size in components)
    return np.full((*shape, *more), False if dtype is bool else np.nan, dtype)
