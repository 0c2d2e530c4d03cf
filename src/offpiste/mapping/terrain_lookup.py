"""The one place where maps are read: nearest cell for features, bilinear slopes for normals (DESIGN.md, "Conventions").

Off the map, or where nothing is known: flat ground, and features marked missing.

The ground under many wheels at once: `lookup.look_up` as a loop, for planners that read one map a million times.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from offpiste.compilation import MAPPING
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.state import Terrain
from offpiste.threads import spread

Encode = Callable[[Float[Tensor, "M F"], Bool[Tensor, " M"]], Float[Tensor, "M E"]]
"""From features and whether they are there to codes (`offpiste.dynamics.encoder`)."""


@dataclass(frozen=True)
class MapStack:
    """Maps of one resolution side by side, padded with unknown cells to one size.

    Attributes:
        origin: x, y of the centre of cell [0, 0] of each [m].
        slope: rise towards +x and towards +y at cell centres; NaN where unknown.
        features: NaN where missing.
    """

    resolution: float
    origin: Float[Tensor, "S 2"]
    slope: Float[Tensor, "S ny nx 2"]
    features: Float[Tensor, "S ny nx F"]


@dataclass(frozen=True)
class Found:
    """What lies at places.

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
        torch.from_numpy(slope).to(place),
        torch.from_numpy(features).to(place),
    )


def _rise(terrain: TerrainMap) -> Float[np.ndarray, "ny nx 2"]:
    if terrain.rise is not None:
        return terrain.rise
    rise_y, rise_x = np.gradient(terrain.elevation.astype(np.float64), terrain.resolution)
    return np.stack((rise_x, rise_y), axis=-1)


def look_up(
    maps: MapStack, number: Int[Tensor, "*P"], place: Float[Tensor, "*P 2"], offset: Float[Tensor, "*P 2"]
) -> Found:
    """The ground at places.

    Args:
        number: of the map that is read at each place.
        place: x, y [m].
        offset: of the frame of `place` in the world frame (float64), so that places can be float32 [m].
    """
    _, ny, nx, _ = maps.slope.shape
    cell = (place + (offset - maps.origin[number]).to(place.dtype)) / maps.resolution
    limit = cell.new_tensor([nx - 1, ny - 1])
    # A place belongs to the map while it is nearest to one of its cells.
    inside = ((cell > -0.5) & (cell < limit + 0.5)).all(dim=-1)
    cell = torch.where(inside[..., None], cell, torch.zeros_like(cell)).clamp(min=0)
    cell = torch.minimum(cell, limit)

    nearest = cell.round().long()
    features = maps.features[number, nearest[..., 1], nearest[..., 0]].to(place.dtype)
    valid = inside & torch.isfinite(features).all(dim=-1)

    corner = torch.minimum(cell.floor(), (limit - 1).clamp(min=0)).long()
    u, v = (cell - corner).unbind(dim=-1)
    x0, y0 = corner.unbind(dim=-1)
    x1, y1 = (x0 + 1).clamp(max=nx - 1), (y0 + 1).clamp(max=ny - 1)

    def at(y: Tensor, x: Tensor) -> Tensor:
        return maps.slope[number, y, x].to(place.dtype)

    near = at(y0, x0) * (1 - u)[..., None] + at(y0, x1) * u[..., None]
    far = at(y1, x0) * (1 - u)[..., None] + at(y1, x1) * u[..., None]
    slope = near * (1 - v)[..., None] + far * v[..., None]
    known = inside & torch.isfinite(slope).all(dim=-1)
    slope = torch.where(known[..., None], slope, torch.zeros_like(slope))
    normal = torch.cat((-slope, torch.ones_like(slope[..., :1])), dim=-1)
    return Found(torch.nn.functional.normalize(normal, dim=-1), known, features, valid)


@dataclass(frozen=True)
class MapTerrain:
    """A terrain source that reads maps under the wheels of the predicted state.

    Attributes:
        maps, number: the maps, and which of them each rollout reads.
        offset: of each rollout's frame in the world frame [m] (float64).
        wheels: in the body frame, from the pose point [m].
        encode: features to codes; None for models without features.
    """

    maps: MapStack
    number: Int[Tensor, " B"]
    offset: Float[Tensor, "B 2"]
    wheels: Float[Tensor, "4 2"]
    encode: Encode | None = None

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """The ground under the wheels of vehicles in `state`; `t` is not looked at."""
        px, py, yaw = (column[:, None] for column in state[:, :3].unbind(dim=-1))
        x, y = self.wheels.to(state.dtype).unbind(dim=-1)
        cos, sin = torch.cos(yaw), torch.sin(yaw)
        place = torch.stack((px + cos * x - sin * y, py + sin * x + cos * y), dim=-1)
        found = look_up(self.maps, self.number[:, None].expand(-1, 4), place, self.offset[:, None].expand(-1, 4, -1))
        if self.encode is None:
            return Terrain(found.normal, found.normal[..., :0])
        codes = self.encode(found.features.flatten(0, 1), found.valid.flatten())
        return Terrain(found.normal, codes.unflatten(0, (-1, 4)))


@dataclass(frozen=True)
class HeldCodes:
    """Normals under the wheels of the predicted state, codes of the start (`hold`)."""

    source: MapTerrain
    latent: Float[Tensor, "B 4 E"]

    @classmethod
    def of(cls, source: MapTerrain, state: Float[Tensor, "B 6"]) -> "HeldCodes":
        """A source that keeps the codes that lie under the wheels in `state`."""
        return cls(replace(source, encode=None), source.at(0, state).latent)

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """The ground under the wheels in `state`, as it looked at the start."""
        return Terrain(self.source.at(t, state).normal, self.latent)


def as_codes(missing: Float[Tensor, " E"]) -> Encode:
    """Reads features that are codes already.

    Args:
        missing: `FeatureEncoder.missing()`.
    """
    return lambda codes, valid: torch.where(valid[:, None], codes, missing)


def look_up_wheels(
    maps: MapStack,
    number: int,
    place: Float[Tensor, "P 2"],
    offset: Float[Tensor, " 2"],
    *,
    threads: int = 1,
    out: Found | None = None,
) -> Found:
    """The same as `look_up` for places on one map, on the CPU, in float32.

    Args:
        number: of the map that is read.
        place: x, y [m] (float32).
        offset: of the frame of `place` in the world frame (float64) [m].
        out: what an earlier call for as many places returned, written over.

    Raises:
        ValueError: places or a map that are not float32 on the CPU.
    """
    tensors = (place, maps.slope, maps.features)
    if any(tensor.dtype != torch.float32 or tensor.device.type != "cpu" for tensor in tensors):
        raise ValueError("wheels are looked up in float32 on the CPU; use look_up")
    count, channels = len(place), maps.features.shape[-1]
    out = out or Found(
        torch.empty(count, 3),
        torch.empty(count, dtype=torch.bool),
        torch.empty(count, channels),
        torch.empty(count, dtype=torch.bool),
    )
    shift = (offset - maps.origin[number]).numpy().astype(np.float32)
    arrays: list[Any] = [
        tensor.numpy()
        for tensor in (
            place.contiguous(),
            maps.slope[number],
            maps.features[number],
            out.normal,
            out.known,
            out.features,
            out.valid,
        )
    ]
    spread(threads, count, lookup_kernel, shift, np.float32(1 / maps.resolution), *arrays)
    return out


@MAPPING.entry
def lookup_kernel(first, last, shift, scale, place, slope, features, normal, known, found, valid):  # type: ignore[no-untyped-def]
    """The ground at places `first` to `last`."""
    ny, nx = slope.shape[0], slope.shape[1]
    last_x, last_y = np.float32(nx - 1), np.float32(ny - 1)
    zero, one, half = np.float32(0), np.float32(1), np.float32(0.5)
    for p in range(first, last):
        x, y = (place[p, 0] + shift[0]) * scale, (place[p, 1] + shift[1]) * scale
        # A place belongs to the map while it is nearest to one of its cells; what is not a number does not.
        inside = x > -half and x < last_x + half and y > -half and y < last_y + half
        x, y = (x, y) if inside else (zero, zero)
        x = min(max(x, zero), last_x)
        y = min(max(y, zero), last_y)

        i, j = np.int64(np.rint(x)), np.int64(np.rint(y))
        there = inside
        for k in range(features.shape[2]):
            value = features[j, i, k]
            found[p, k] = value
            there &= value - value == 0
        valid[p] = there

        x0, y0 = min(np.int64(x), max(nx - 2, 0)), min(np.int64(y), max(ny - 2, 0))
        x1, y1 = min(x0 + 1, nx - 1), min(y0 + 1, ny - 1)
        u, v = x - np.float32(x0), y - np.float32(y0)
        rise_x = (slope[y0, x0, 0] * (one - u) + slope[y0, x1, 0] * u) * (one - v)
        rise_x += (slope[y1, x0, 0] * (one - u) + slope[y1, x1, 0] * u) * v
        rise_y = (slope[y0, x0, 1] * (one - u) + slope[y0, x1, 1] * u) * (one - v)
        rise_y += (slope[y1, x0, 1] * (one - u) + slope[y1, x1, 1] * u) * v
        sloped = inside and rise_x - rise_x == 0 and rise_y - rise_y == 0
        rise_x, rise_y = (rise_x, rise_y) if sloped else (zero, zero)
        up = one / np.sqrt(one + rise_x * rise_x + rise_y * rise_y)
        known[p] = sloped
        normal[p, 0], normal[p, 1], normal[p, 2] = -rise_x * up, -rise_y * up, up
