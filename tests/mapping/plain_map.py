"""The map once more in plain NumPy: what the loops must agree with, and what they are timed against."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.mapping.normals import MIN_SPREAD
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.mapping.voxel_map import FUSION_RULES, LEVELS, VoxelSettings
from offpiste.mapping.voxels_to_layers import FlattenSettings, neighbour_offsets


@dataclass(frozen=True)
class Memory:
    """One observation a voxel: `values` taken from `distance`, out of `hits` observations.

    Attributes:
        cell: integer coordinates x, y, z of the voxel.
    """

    cell: Int[np.ndarray, "V 3"]
    values: Float[np.ndarray, "V C"]
    distance: Float[np.ndarray, " V"]
    hits: Int[np.ndarray, " V"]

    def of(self, rows: np.ndarray) -> "Memory":
        """Some of the voxels."""
        return Memory(self.cell[rows], self.values[rows], self.distance[rows], self.hits[rows])


def fuse(before: Memory, new: Memory, rule: str) -> Memory:
    """Both memories as one, with one observation a voxel: the new ones come in, in their order."""
    cell = np.concatenate((before.cell, new.cell))
    values = np.concatenate((before.values, new.values))
    distance = np.concatenate((before.distance, new.distance))
    hits = np.concatenate((before.hits, new.hits))
    order = np.lexsort((np.arange(len(cell)), *cell.T))
    cell, values, distance, hits = cell[order], values[order], distance[order], hits[order]
    start = np.flatnonzero(np.r_[True, (cell[1:] != cell[:-1]).any(axis=1)][: len(cell)])
    length = np.diff(np.append(start, len(cell)))
    fused = Memory(cell[start], values[start], distance[start], hits[start])
    for k in range(1, length.max(initial=1)):  # the k-th further observation of every voxel that has so many
        voxel = np.flatnonzero(length > k)
        row = start[voxel] + k
        fused.hits[voxel] += hits[row]
        share = FUSION_RULES[rule](distance[row], fused.distance[voxel], fused.hits[voxel])
        share = np.broadcast_to(np.asarray(share, float), len(row))
        for held, seen in ((fused.values, values[row]), (fused.distance, distance[row])):
            part = share[:, None] if held.ndim == 2 else share
            held[voxel] = np.where(part == 1, seen, held[voxel] + (seen - held[voxel]) * part)
    return fused


@dataclass(frozen=True)
class ReferenceMap:
    """What `voxels.VoxelMap` holds: where voxels were hit, and what they looked like."""

    settings: VoxelSettings
    channels: int
    low: Int[np.ndarray, " 2"]
    middle: float = 0.0
    places: Memory = field(default_factory=lambda: _nothing(3))
    looks: Memory = field(default_factory=lambda: _nothing(0))


def empty_reference(channels: int, settings: VoxelSettings) -> ReferenceMap:
    """A map around the world's origin in which nothing was seen."""
    low = np.full(2, -settings.half_cells, np.int64)
    return ReferenceMap(settings, channels, low, looks=_nothing(channels))


def _nothing(values: int) -> Memory:
    return Memory(np.zeros((0, 3), np.int64), np.zeros((0, values)), np.zeros(0), np.zeros(0, np.int64))


def recentred(old: ReferenceMap, xy: Float[np.ndarray, " 2"], z: float) -> ReferenceMap:
    """As `VoxelMap.recentre`."""
    low = np.floor(xy * (1 / old.settings.size) + 0.5).astype(np.int64) - old.settings.half_cells
    moved = replace(old, low=low, middle=z)
    places, looks = (m.of(_inside(moved, m.cell[:, :2])) for m in (old.places, old.looks))
    return replace(moved, places=places, looks=looks)


def _inside(where: ReferenceMap, cell: np.ndarray) -> Bool[np.ndarray, " N"]:
    return np.all((cell >= where.low) & (cell < where.low + 2 * where.settings.half_cells), axis=1)


def inserted(
    old: ReferenceMap,
    points_world: Float[np.ndarray, "N 3"],
    features: Float[np.ndarray, "N F"],
    has_feature: Bool[np.ndarray, " N"],
    distance: Float[np.ndarray, " N"],
) -> ReferenceMap:
    """As `VoxelMap.insert`."""
    scaled = points_world * (1 / old.settings.size)
    good = np.abs(points_world[:, 2] - old.middle) <= old.settings.height_reach
    good &= _inside(old, np.floor(scaled[:, :2]))
    good &= (distance >= 0) & (distance < np.inf)
    scaled, distance = scaled[good], distance[good].astype(np.float64)
    cell = np.floor(scaled).astype(np.int64)
    once = np.ones(len(cell), np.int64)
    seen = has_feature[good] & np.isfinite(features[good]).all(axis=1)
    places = fuse(old.places, Memory(cell, scaled, distance, once), old.settings.rule)
    new = Memory(cell[seen], features[good][seen].astype(np.float64), distance[seen], once[seen])
    looks = fuse(old.looks, new, old.settings.rule)
    n = 2 * old.settings.half_cells
    base = np.full((n, n), np.iinfo(np.int64).max - LEVELS)
    np.minimum.at(base, tuple((places.cell[:, :2] - old.low).T), places.cell[:, 2])
    kept = [m.of(m.cell[:, 2] < base[tuple((m.cell[:, :2] - old.low).T)] + LEVELS) for m in (places, looks)]
    return replace(old, places=kept[0], looks=kept[1])


def flattened(held: ReferenceMap, settings: FlattenSettings) -> TerrainLayers:
    """As `flatten.flatten`."""
    size, n = held.settings.size, 2 * held.settings.half_cells
    point = _lowest(held.places, held.low, n)
    point[..., :2] -= np.mgrid[:n, :n][::-1].transpose(1, 2, 0) + held.low + 0.5
    ground, reach = point[..., 2] * size, settings.vehicle_height

    i, j = (held.places.cell[:, :2] - held.low).T
    above = held.places.values[:, 2] * size - ground[j, i]
    obstacle = np.zeros((n, n))
    np.maximum.at(obstacle, (j, i), np.where(above <= reach, above, 0.0))

    # The place of a look is that of its voxel: both memories are sorted in the same way.
    looked = replace(held.looks, values=_rows_of(held.looks.cell, held.places))
    look_row = _lowest(replace(looked, values=np.arange(len(looked.cell))[:, None] * 1.0), held.low, n)[..., 0]
    look_height = _lowest(looked, held.low, n)[..., 2] * size

    around = round(settings.overhang_radius / size)
    lowest = np.min([_shifted(ground, dy, dx, np.inf) for dy, dx in _box(around)], axis=0, initial=np.inf)
    with np.errstate(invalid="ignore"):
        ground[ground > lowest + reach] = np.nan
        look_row[~(look_height - ground <= settings.feature_height)] = np.nan

    rise, centre, roughness = _planes(point, ground, max(1, round(settings.plane_radius / size)), size)
    source, known = _nearest(np.isfinite(ground), neighbour_offsets(settings.fill_radius / size), n)
    fill = (source[..., 0], source[..., 1])

    def filled(layer: np.ndarray) -> np.ndarray:
        return np.where(known.reshape(known.shape + (1,) * (layer.ndim - 2)), layer[fill], np.nan)

    rise = filled(rise)
    normal = np.concatenate((-rise, np.ones((n, n, 1))), axis=2)
    normal = np.where(np.isfinite(rise[..., :1]), normal / np.linalg.norm(normal, axis=2, keepdims=True), np.nan)
    look = _filled_looks(look_row, look_height, filled(ground), settings, size)
    valid, which = np.isfinite(look), np.nan_to_num(look).astype(int)
    features, distance = np.full((n, n, held.channels), np.nan), np.full((n, n), np.nan)
    features[valid], distance[valid] = held.looks.values[which[valid]], held.looks.distance[which[valid]]
    return TerrainLayers(
        (held.low + 0.5) * size,
        size,
        filled(centre),
        normal,
        np.hypot(rise[..., 0], rise[..., 1]),
        filled(roughness),
        filled(obstacle),
        features,
        distance,
        known,
        np.isfinite(ground),
        valid,
    )


def _lowest(memory: Memory, low: np.ndarray, n: int) -> Float[np.ndarray, "n n C"]:
    """Values of the lowest voxel of each column."""
    order = np.argsort(-memory.cell[:, 2], kind="stable")
    i, j = (memory.cell[order, :2] - low).T
    out = np.full((n, n, memory.values.shape[1]), np.nan)
    out[j, i] = memory.values[order]  # of several the last, the lowest, stays
    return out


def _rows_of(cell: Int[np.ndarray, "V 3"], places: Memory) -> Float[np.ndarray, "V 3"]:
    """Where voxels were hit."""
    both = np.concatenate((places.cell, cell))
    _, number = np.unique(both, axis=0, return_inverse=True)
    number = number.reshape(-1)
    row = np.empty(len(both), np.int64)
    row[number[: len(places.cell)]] = np.arange(len(places.cell))
    return places.values[row[number[len(places.cell) :]]]


def _box(radius: int) -> list[tuple[int, int]]:
    return [(dy, dx) for dy in range(-radius, radius + 1) for dx in range(-radius, radius + 1)]


def _shifted(layer: np.ndarray, dy: int, dx: int, fill: float) -> np.ndarray:
    """The layer as seen from `dy` rows and `dx` columns before: [j, i] -> [j + dy, i + dx]; `fill` for NaN too."""
    most = max(abs(dy), abs(dx))
    wide = np.pad(np.where(np.isfinite(layer), layer, fill), most, constant_values=fill)
    ny, nx = layer.shape
    return wide[most + dy : most + dy + ny, most + dx : most + dx + nx]


def _planes(
    point: np.ndarray, ground: np.ndarray, radius: int, size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rise [n n 2], height at the centre, roughness."""
    there = np.isfinite(ground)
    count, mean = np.zeros(ground.shape), np.zeros((*ground.shape, 3))
    shifted = []
    for dy, dx in _box(radius):
        w = _shifted(there * 1.0, dy, dx, 0.0)
        x, y, z = (_shifted(layer, dy, dx, 0.0) for layer in (point[..., 0], point[..., 1], ground))
        p = np.stack((x + dx, y + dy, z), axis=2)
        shifted.append((w, p))
        count += w
        mean += w[..., None] * p
    with np.errstate(invalid="ignore", divide="ignore"):
        mean /= count[..., None]
        spread = sum(w[..., None, None] * (p - mean)[..., :, None] * (p - mean)[..., None, :] for w, p in shifted)
        spread = spread / count[..., None, None]
        least = np.linalg.eigvalsh(np.nan_to_num(spread[..., :2, :2]))[..., 0]
        good = there & (count >= 3) & (least >= MIN_SPREAD)
        rise = np.full((*ground.shape, 2), np.nan)
        rise[good] = np.linalg.solve(spread[good][:, :2, :2], spread[good][:, :2, 2:])[..., 0]
        down = np.nan_to_num((rise * point[..., :2]).sum(axis=2)).clip(-size, size)
        residual = (ground - mean[..., 2] - (rise * (point[..., :2] - mean[..., :2])).sum(axis=2)) ** 2
        rough = [_shifted(residual, dy, dx, 0.0) for dy, dx in _box(radius)]
        known = [_shifted(np.isfinite(residual) * 1.0, dy, dx, 0.0) for dy, dx in _box(radius)]
        roughness = np.sqrt(np.sum(rough, axis=0) / np.sum(known, axis=0))
    return rise / size, ground - down, np.where(good, roughness, np.nan)


def _nearest(
    there: np.ndarray, offsets: np.ndarray, n: int
) -> tuple[Int[np.ndarray, "n n 2"], Bool[np.ndarray, "n n"]]:
    """Row and column of the nearest cell that is there, and whether one is."""
    cell = np.mgrid[:n, :n].transpose(1, 2, 0)
    source, known = cell.copy(), there.copy()
    for dy, dx in offsets.tolist():
        take = ~known & (_shifted(there * 1.0, dy, dx, 0.0) > 0)
        source[take] = cell[take] + (dy, dx)
        known |= take
    return source, known


def _filled_looks(
    row: np.ndarray, height: np.ndarray, ground: np.ndarray, settings: FlattenSettings, size: float
) -> Float[np.ndarray, "n n"]:
    """The look of each cell or of the nearest whose height fits the ground here; NaN if none does."""
    out = np.full(row.shape, np.nan)
    for dy, dx in neighbour_offsets(settings.fill_radius / size).tolist():
        there = _shifted(row, dy, dx, -1.0)
        with np.errstate(invalid="ignore"):
            off = np.abs(_shifted(height, dy, dx, np.inf) - ground)
            take = np.isnan(out) & (there >= 0) & (off <= settings.feature_height)
        out[take] = there[take]
    return out
