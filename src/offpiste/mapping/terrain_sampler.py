"""The one sampler of terrain maps: nearest cell for features, bilinear slopes for normals (docs/method.md).

Off the map, or where nothing is known: flat ground, and features marked missing. Its kernel twin, for planners that
sample one map a million times, is `planning.kernel_terrain`; both use the cells and wheel positions of `terrain_map`.
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
"""From features and whether they are there to codes (`offpiste.dynamics.feature_encoder`)."""


@dataclass(frozen=True)
class MapStack:
    """Maps of one resolution side by side, padded with unknown cells to one size.

    Attributes:
        origin: x, y of the centre of cell [0, 0] of each [m].
        last: column and row of the last cell of each; what lies behind is padding, and off the map.
        slope: rise towards +x and towards +y at cell centres; NaN where unknown.
        features: NaN where missing.
    """

    resolution: float
    origin: Float[Tensor, "S 2"]
    last: Int[Tensor, "S 2"]
    slope: Float[Tensor, "S ny nx 2"]
    features: Float[Tensor, "S ny nx F"]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of each map, padding included."""
        return self.slope.shape[1], self.slope.shape[2]

    def slope_at(self, number: Tensor, row: Tensor, column: Tensor) -> Float[Tensor, "*P 2"]:
        """Slopes of cells."""
        return self.slope[number, row, column]

    def features_at(self, number: Tensor, row: Tensor, column: Tensor) -> Float[Tensor, "*P F"]:
        """Features of cells."""
        return self.features[number, row, column]


@dataclass(frozen=True)
class CellStack:
    """Maps of one resolution side by side as lists of their known cells, for maps that are mostly unknown.

    Attributes:
        origin: x, y of the centre of cell [0, 0] of each [m].
        last: as of a `MapStack`.
        place: number of each cell in the lists; -1, their last entry, where nothing is known.
        slope: rise towards +x and towards +y at cell centres; NaN where unknown, and in the last entry.
        features: NaN where missing, and in the last entry.
    """

    resolution: float
    origin: Float[Tensor, "S 2"]
    last: Int[Tensor, "S 2"]
    place: Int32[Tensor, "S ny nx"]
    slope: Float[Tensor, "C 2"]
    features: Float[Tensor, "C F"]

    def slope_at(self, number: Tensor, row: Tensor, column: Tensor) -> Float[Tensor, "*P 2"]:
        """Slopes of cells."""
        return self.slope[self.place[number, row, column].long()]

    def features_at(self, number: Tensor, row: Tensor, column: Tensor) -> Float[Tensor, "*P F"]:
        """Features of cells."""
        return self.features[self.place[number, row, column].long()]


@dataclass(frozen=True)
class TerrainSample:
    """The ground at places.

    Attributes:
        normal: unit surface normals in the world frame; straight up where `known` is false.
        known: whether the slope is.
        features: NaN where not `valid`.
        valid: whether there are features.
    """

    normal: Float[Tensor, "*P 3"]
    known: Bool[Tensor, "*P"]
    features: Float[Tensor, "*P F"]
    valid: Bool[Tensor, "*P"]


def stack_maps(maps: Sequence[TerrainMap], *, device: torch.device | str = "cpu") -> MapStack:
    """Maps as tensors, for lookups.

    Raises:
        ValueError: no map, or maps of several resolutions.
    """
    if len({m.resolution for m in maps}) != 1:
        raise ValueError(f"maps of one resolution are needed, not {sorted({m.resolution for m in maps})}")
    ny, nx = (max(m.elevation.shape[axis] for m in maps) for axis in (0, 1))
    slope = np.full((len(maps), ny, nx, 2), np.nan, np.float32)
    features = np.full((len(maps), ny, nx, maps[0].features.shape[2]), np.nan, maps[0].features.dtype)
    for number, terrain in enumerate(maps):
        rows, columns = terrain.elevation.shape
        slope[number, :rows, :columns] = _rise(terrain)
        features[number, :rows, :columns] = terrain.features
    origin = torch.as_tensor(np.stack([m.origin for m in maps]), dtype=torch.float64)
    place = torch.device(device)
    return MapStack(
        maps[0].resolution,
        origin.to(place),
        last_cells([m.elevation.shape for m in maps]).to(place),
        torch.from_numpy(slope).to(place),
        torch.from_numpy(features).to(place),
    )


def last_cells(shapes: Sequence[tuple[int, ...]]) -> Int[Tensor, "S 2"]:
    """Column and row of the last cell of maps of so many rows and columns."""
    return torch.tensor([[columns - 1, rows - 1] for rows, columns in shapes])


def _rise(terrain: TerrainMap) -> Float[np.ndarray, "ny nx 2"]:
    if terrain.rise is not None:
        return terrain.rise
    rise_y, rise_x = np.gradient(terrain.elevation.astype(np.float64), terrain.resolution)
    return np.stack((rise_x, rise_y), axis=-1)


def sample_maps(
    maps: MapStack | CellStack, number: Int[Tensor, "*P"], place: Float[Tensor, "*P 2"], offset: Float[Tensor, "*P 2"]
) -> TerrainSample:
    """Sample maps at places.

    Args:
        number: of the map that is read at each place.
        place: x, y [m].
        offset: of the frame of `place` in the world frame (float64), so that places can be float32 [m].
    """
    cell = (place + (offset - maps.origin[number]).to(place.dtype)) / maps.resolution
    last = maps.last[number]
    limit = last.to(cell.dtype)
    # A place belongs to the map while it is nearest to one of its cells.
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
    """A terrain source that reads maps under the wheels of the predicted state.

    Attributes:
        maps, number: the maps, and which of them each rollout reads.
        offset: of each rollout's frame in the world frame [m] (float64).
        wheels: in the body frame, from the pose point [m].
        encode: features to codes; None for models without features.
    """

    maps: MapStack | CellStack
    number: Int[Tensor, " B"]
    offset: Float[Tensor, "B 2"]
    wheels: Float[Tensor, "4 2"]
    encode: Encode | None = None

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """The ground under the wheels of vehicles in `state`; `t` is not used."""
        place = wheel_positions_of_states(state, self.wheels)
        result = sample_maps(
            self.maps, self.number[:, None].expand(-1, 4), place, self.offset[:, None].expand(-1, 4, -1)
        )
        if self.encode is None:
            return Terrain(result.normal, result.known, result.normal[..., :0])
        codes = self.encode(result.features.flatten(0, 1), result.valid.flatten())
        return Terrain(result.normal, result.known, codes.unflatten(0, (-1, 4)))


def as_codes(missing: Float[Tensor, " E"]) -> Encode:
    """An `Encode` for features that are codes already.

    Args:
        missing: `FeatureEncoder.missing()`.
    """
    return lambda codes, valid: torch.where(valid[:, None], codes, missing)
