"""Sampler of terrain maps: nearest cell for features, bilinear slopes for normals (docs/method.md).

Unknown places and places off the map give flat ground and missing features. `native/cpp/ground.h` is the compiled
twin for planners; both use the cells and wheel positions of `terrain_map`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Int32
from torch import Tensor

from offpiste.core.state import Terrain
from offpiste.mapping.terrain_map import TerrainMap, bilinear, on_map, wheel_positions_of_states

Encode = Callable[[Float[Tensor, "M F"], Bool[Tensor, " M"]], Float[Tensor, "M E"]]
"""Encoder of features and their validity into codes (`offpiste.dynamics.feature_encoder`)."""


@dataclass(frozen=True)
class MapStack:
    """Stack of maps of one resolution, padded with unknown cells to one size."""

    resolution: float
    origin: Float[Tensor, "S 2"]  # x, y of the centre of cell [0, 0] of each map [m]
    last: Int[Tensor, "S 2"]  # column and row of the last cell of each map, before the padding
    slope: Float[Tensor, "S ny nx 2"]  # rise towards +x and +y at cell centres; NaN where unknown
    features: Float[Tensor, "S ny nx F"]  # NaN where missing

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of each map, including padding."""
        return self.slope.shape[1], self.slope.shape[2]

    def slope_at(self, number: Tensor, row: Tensor, column: Tensor) -> Float[Tensor, "*P 2"]:
        """Return the slopes of cells."""
        return self.slope[number, row, column]

    def features_at(self, number: Tensor, row: Tensor, column: Tensor) -> Float[Tensor, "*P F"]:
        """Return the features of cells."""
        return self.features[number, row, column]


@dataclass(frozen=True)
class CellStack:
    """Stack of maps of one resolution as lists of known cells, for maps that are mostly unknown."""

    resolution: float
    origin: Float[Tensor, "S 2"]  # as in `MapStack`
    last: Int[Tensor, "S 2"]
    place: Int32[Tensor, "S ny nx"]  # index of each cell in the lists; -1, their last entry, where unknown
    slope: Float[Tensor, "C 2"]  # rise towards +x and +y at cell centres; NaN where unknown and in the last entry
    features: Float[Tensor, "C F"]  # NaN where missing and in the last entry

    def slope_at(self, number: Tensor, row: Tensor, column: Tensor) -> Float[Tensor, "*P 2"]:
        """Return the slopes of cells."""
        return self.slope[self.place[number, row, column].long()]

    def features_at(self, number: Tensor, row: Tensor, column: Tensor) -> Float[Tensor, "*P F"]:
        """Return the features of cells."""
        return self.features[self.place[number, row, column].long()]


@dataclass(frozen=True)
class TerrainSample:
    """Ground at sampled positions."""

    normal: Float[Tensor, "*P 3"]  # unit surface normals in the world frame; vertical where the slope is not `known`
    known: Bool[Tensor, "*P"]  # mask of known slopes
    features: Float[Tensor, "*P F"]  # NaN where not `valid`
    valid: Bool[Tensor, "*P"]  # mask of known features


def stack_maps(maps: Sequence[TerrainMap], *, device: torch.device | str = "cpu") -> MapStack:
    """Stack maps of one resolution as tensors."""
    if len({m.resolution for m in maps}) != 1:
        raise ValueError(f"maps of one resolution are needed, not {sorted({m.resolution for m in maps})}")
    ny, nx = (max(m.elevation.shape[axis] for m in maps) for axis in (0, 1))
    slope = np.full((len(maps), ny, nx, 2), np.nan, np.float32)
    features = np.full((len(maps), ny, nx, maps[0].features.shape[2]), np.nan, maps[0].features.dtype)
    for number, terrain in enumerate(maps):
        (rows, columns), rise = terrain.elevation.shape, terrain.rise
        if rise is None:
            rise_y, rise_x = np.gradient(terrain.elevation.astype(np.float64), terrain.resolution)
            rise = np.stack((rise_x, rise_y), axis=-1)
        slope[number, :rows, :columns] = rise
        features[number, :rows, :columns] = terrain.features
    origin = torch.as_tensor(np.stack([m.origin for m in maps]), dtype=torch.float64)
    last = last_cells([m.elevation.shape for m in maps])
    tensors = (origin, last, torch.from_numpy(slope), torch.from_numpy(features))
    return MapStack(maps[0].resolution, *(tensor.to(device) for tensor in tensors))


def last_cells(shapes: Sequence[tuple[int, ...]]) -> Int[Tensor, "S 2"]:
    """Return column and row of the last cell of maps of these shapes."""
    return torch.tensor([[columns - 1, rows - 1] for rows, columns in shapes])


def sample_maps(
    maps: MapStack | CellStack, number: Int[Tensor, "*P"], place: Float[Tensor, "*P 2"], offset: Float[Tensor, "*P 2"]
) -> TerrainSample:
    """Sample maps at positions.

    Args:
        number: index of the map to read at each position.
        place: positions x, y [m].
        offset: origin of the frame of `place` in the world frame (float64), so that positions can be float32 [m].
    """
    cell = (place + (offset - maps.origin[number]).to(place.dtype)) / maps.resolution
    last = maps.last[number]
    limit = last.to(cell.dtype)
    inside = on_map(cell[..., 0], cell[..., 1], limit[..., 0], limit[..., 1], 0.5)
    cell = torch.where(inside[..., None], cell, torch.zeros_like(cell)).clamp(min=0)
    cell = torch.minimum(cell, limit)

    nearest = cell.round().long()
    features = maps.features_at(number, nearest[..., 1], nearest[..., 0]).to(place.dtype)
    valid = inside & torch.isfinite(features).all(dim=-1)

    corner = torch.minimum(cell.floor(), (limit - 1).clamp(min=0)).long()
    u, v = (cell - corner).unbind(dim=-1)
    x0, y0 = corner.unbind(dim=-1)
    x1, y1 = torch.minimum(corner + 1, last).unbind(dim=-1)

    def at(y: Tensor, x: Tensor) -> Tensor:
        return maps.slope_at(number, y, x).to(place.dtype)

    slope = bilinear(at(y0, x0), at(y0, x1), at(y1, x0), at(y1, x1), u[..., None], v[..., None], 1)
    known = inside & torch.isfinite(slope).all(dim=-1)
    slope = torch.where(known[..., None], slope, torch.zeros_like(slope))
    normal = torch.cat((-slope, torch.ones_like(slope[..., :1])), dim=-1)
    return TerrainSample(torch.nn.functional.normalize(normal, dim=-1), known, features, valid)


@dataclass(frozen=True)
class MapTerrain:
    """Terrain source that reads maps under the wheels of the predicted state."""

    maps: MapStack | CellStack
    number: Int[Tensor, " B"]  # index of the map of each rollout
    offset: Float[Tensor, "B 2"]  # origin of each rollout's frame in the world frame (float64) [m]
    wheels: Float[Tensor, "4 2"]  # wheel positions in the body frame, from the pose point [m]
    encode: Encode | None = None  # encoder of features; None for models without features

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """Return the ground under the wheels of vehicles in `state`; `t` is ignored."""
        place = wheel_positions_of_states(state, self.wheels)
        result = sample_maps(
            self.maps, self.number[:, None].expand(-1, 4), place, self.offset[:, None].expand(-1, 4, -1)
        )
        if self.encode is None:
            return Terrain(result.normal, result.known, result.normal[..., :0])
        codes = self.encode(result.features.flatten(0, 1), result.valid.flatten())
        return Terrain(result.normal, result.known, codes.unflatten(0, (-1, 4)))


def as_codes(missing: Float[Tensor, " E"]) -> Encode:
    """Return the `Encode` of features that are codes already; `missing` is `FeatureEncoder.missing()`."""
    return lambda codes, valid: torch.where(valid[:, None], codes, missing)
