"""Snapshots of the map at the start of validation and test windows, as a planner would have read it.

A snapshot is a list of the known cells within reach of a window.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
import zarr
from jaxtyping import Bool, Float, Float16, Float32, Int, Int32
from scipy.spatial.distance import cdist
from torch import Tensor
from zarr.codecs import Crc32cCodec, ZstdCodec

from offpiste.core.conventions import DT, HORIZON_STEPS, PERCEPTION_LATENCY
from offpiste.core.errors import DatasetError
from offpiste.core.limits import zstd
from offpiste.dataset.stored_arrays import open_stored, refuse_expanding
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.mapping.terrain_sampler import CellStack, last_cells

_STARTING, _BACKWARDS = 4.0, 0.5
"""Mean speed that a starting vehicle may reach, and speed above which it drives backwards [m/s]."""

SNAPSHOT_PARTS = ("validation", "test")  # parts with snapshots; training needs none
MARGIN = 18.0  # added to the radius of a snapshot [m]
CHUNK = 8192  # cells per chunk of the store; a snapshot has some ten thousand

_MOST_CELLS: Final = 1 << 22
"""Largest number of cells of a snapshot, known or not: it reaches some 50 m around the vehicle."""


@dataclass(frozen=True)
class CellList:
    """Known cells of a map."""

    origin: Float[np.ndarray, " 2"]  # x, y of the centre of cell [0, 0] of the map [m]
    resolution: float  # size of a cell [m]
    shape: tuple[int, int]  # rows and columns of the map
    place: Int32[np.ndarray, " C"]  # row * columns + column
    elevation: Float32[np.ndarray, " C"]  # [m]
    rise: Float16[np.ndarray, "C 2"]  # slope towards +x and +y; NaN where unknown
    features: Float16[np.ndarray, "C F"]  # NaN where missing

    def terrain_map(self) -> TerrainMap:
        """Return the map, NaN in all other cells."""
        ny, nx = self.shape

        def spread(values: np.ndarray) -> np.ndarray:
            full = np.full((ny * nx, *values.shape[1:]), np.nan, values.dtype)
            full[self.place] = values
            return full.reshape(ny, nx, *values.shape[1:])

        layers = spread(self.elevation), spread(self.features), spread(self.rise)
        return TerrainMap(self.origin, self.resolution, *layers)

    def near(self, path: Float[np.ndarray, "P 2"], margin: float) -> "CellList":
        """Return the cells within `margin` [m] of points of the world, on the smallest grid that holds them."""
        cell = np.stack(np.divmod(self.place, self.shape[1]), axis=-1)
        kept = cdist(self.origin + self.resolution * cell[:, ::-1], path).min(axis=1) <= margin
        low = cell[kept].min(axis=0, initial=max(self.shape))
        ny, nx = (cell[kept].max(axis=0, initial=0) - low + 1).clip(min=1).tolist()
        place = ((cell[kept] - low) @ [nx, 1]).astype(np.int32)
        origin, layers = self.origin + self.resolution * low[::-1], (self.elevation, self.rise, self.features)
        return CellList(origin, self.resolution, (ny, nx), place, *(layer[kept] for layer in layers))


def crop(terrain: TerrainMap, state: Float[np.ndarray, " 6"], margin: float = MARGIN) -> CellList:
    """Copy the known cells of a map within reach of a window, whose start has px and py in the world frame.

    Their radius is half the distance of five seconds at the initial speed, plus a margin [m], around the point half
    that distance ahead, or behind when driving backwards.
    """
    half = 0.5 * HORIZON_STEPS * DT * max(float(np.hypot(state[3], state[4])), _STARTING)
    ahead = -half if state[3] < -_BACKWARDS else half
    centre = state[:2] + ahead * np.array([np.cos(state[2]), np.sin(state[2])])
    near = terrain.cropped(centre - half - margin, centre + half + margin)
    ny, nx = near.elevation.shape
    y, x = (near.origin[1 - axis] + near.resolution * np.arange(n) for axis, n in enumerate((ny, nx)))
    reached = np.hypot(x[None] - centre[0], y[:, None] - centre[1]) <= half + margin
    row, column = np.nonzero(reached & np.isfinite(near.elevation))
    assert near.rise is not None
    return CellList(
        near.origin,
        near.resolution,
        (ny, nx),
        (row * nx + column).astype(np.int32),
        near.elevation[row, column].astype(np.float32),
        near.rise[row, column].astype(np.float16),
        near.features[row, column].astype(np.float16),
    )


def stack_cells(cells: Sequence[CellList], *, device: torch.device | str = "cpu") -> CellStack:
    """Stack maps of one resolution as tensors for lookups."""
    assert len({c.resolution for c in cells}) == 1, "maps of one resolution are needed"
    ny, nx = (max(c.shape[axis] for c in cells) for axis in (0, 1))
    place = np.full((len(cells), ny, nx), -1, np.int32)
    first = np.cumsum([0] + [len(c.place) for c in cells])
    for number, known in enumerate(cells):
        place[number, *np.divmod(known.place, known.shape[1])] = first[number] + np.arange(len(known.place))

    def listed(parts: Sequence[np.ndarray]) -> Tensor:
        nothing = np.full((1, parts[0].shape[1]), np.nan, parts[0].dtype)
        return torch.from_numpy(np.concatenate([*parts, nothing])).to(device)

    origin = torch.as_tensor(np.stack([c.origin for c in cells]), dtype=torch.float64)
    last = last_cells([c.shape for c in cells])
    origin, last, where = (each.to(device) for each in (origin, last, torch.from_numpy(place)))
    lists = listed([c.rise for c in cells]), listed([c.features for c in cells])
    return CellStack(cells[0].resolution, origin, last, where, *lists)


@dataclass(frozen=True)
class SnapshotSettings:
    """Selection of windows with map snapshots, and extent of the snapshots."""

    seconds: float = 0.5  # shortest time between two snapshots of a part [s]
    most: int = 2000  # largest number of snapshots per part of a drive; a longer part has them further apart
    latency: float = PERCEPTION_LATENCY  # shortest age of a measurement in the map at the window's start [s]
    # speed above which windows get a snapshot [m/s]; 0 includes standstills, None: the dataset's
    min_speed: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.latency <= 1:
            raise DatasetError(f"invalid snapshot latency {self.latency:g} s", how="give a time from 0 to 1 s")
        for name, value, unit in (("time between", self.seconds, "s"), ("minimum speed of", self.min_speed, "m/s")):
            if value is not None and not 0 <= value < np.inf:
                raise DatasetError(f"invalid {name} snapshots: {value:g} {unit}", how="give a number of 0 or more")


class SnapshotSchedule:
    """Choice of the rows at which snapshots are taken, from the starts of windows in each evaluated part."""

    def __init__(self, starts: Sequence[Bool[np.ndarray, " N"]], settings: SnapshotSettings) -> None:
        self._starts = starts
        self._apart = [max(settings.seconds / DT, part.sum() / settings.most) for part in starts]
        self._latest = [-np.inf] * len(starts)

    def at(self, row: int) -> bool:
        """Return whether to take a snapshot at `row`; rows must increase from call to call."""
        for part, starts in enumerate(self._starts):
            if 0 <= row < len(starts) and starts[row] and row - self._latest[part] >= self._apart[part]:
                self._latest[part] = row
                return True
        return False


_CELLS: Final[dict[str, tuple[type, tuple[int, ...]]]] = {
    "place": (np.int32, ()),
    "elevation": (np.float32, ()),
    "rise": (np.float16, (2,)),
    "features": (np.float16, (-1,)),
}
"""Type and shape per cell of the arrays of a `CellList`; on disk, those of all snapshots are concatenated."""

_INDEX: Final[dict[str, tuple[type, tuple[int, ...]]]] = {
    "row": (np.int64, (-1,)),
    "first": (np.int64, (-1,)),
    "origin": (np.float64, (-1, 2)),
    "shape": (np.int64, (-1, 2)),
}
"""Type and shape of the arrays with an entry per snapshot."""


class SnapshotWriter:
    """Writer of one drive's snapshots of maps of a resolution [m] with some features into a new Zarr group."""

    def __init__(self, folder: Path, resolution: float, features: int, latency: float = PERCEPTION_LATENCY) -> None:
        attributes: dict[str, Any] = {"resolution": resolution, "latency": latency}
        self._group = zarr.open_group(folder, mode="w-", attributes=attributes, zarr_format=3)
        self._index: dict[str, list[Any]] = {"row": [], "first": [0], "origin": [], "shape": []}
        # Kept, because arrays looked up in the group again would not write chunks of zeros.
        self._cells: dict[str, Any] = {}
        for name, (dtype, shape) in _CELLS.items():
            more = tuple(features if size < 0 else size for size in shape)
            self._cells[name] = self._group.create_array(
                name,
                shape=(0, *more),
                dtype=dtype,
                chunks=(CHUNK, *more),
                compressors=[ZstdCodec(level=1), Crc32cCodec()],
                config={"write_empty_chunks": True},
            )

    def add(self, row: int, cells: CellList) -> None:
        """Add a snapshot for the window that starts at `row` of its drive."""
        for name, array in self._cells.items():
            array.append(getattr(cells, name))
        entry = {"row": row, "first": self._index["first"][-1] + len(cells.place)}
        for name, value in (entry | {"origin": cells.origin, "shape": cells.shape}).items():
            self._index[name].append(value)

    def close(self) -> None:
        """Write the index of the snapshots."""
        for name, (dtype, shape) in _INDEX.items():
            values: np.ndarray = np.array(self._index[name], dtype).reshape(shape)
            self._group.create_array(name, data=values, compressors=Crc32cCodec(), config={"write_empty_chunks": True})


@dataclass(frozen=True)
class Snapshots:
    """Snapshots of one drive, read on demand."""

    folder: Path
    resolution: float  # of the maps [m]
    latency: float  # shortest time from the last measurement to the start of the window [s]
    row: Int[np.ndarray, " S"]  # rows at which snapshots were taken, increasing
    first: Int[np.ndarray, " S+1"]  # index of each snapshot's first cell, and the number of all cells
    origin: Float[np.ndarray, "S 2"]  # of each map
    shape: Int[np.ndarray, "S 2"]
    cells: dict[str, Any]  # arrays of the cells of all snapshots, on disk

    def known_cells(self, number: int) -> CellList:
        """Read the known cells of snapshot `number`; raise `DatasetError` if they are damaged."""
        begin, end = self.first[number : number + 2].tolist()
        ny, nx = self.shape[number].tolist()
        try:
            if not 0 <= end - begin <= ny * nx <= _MOST_CELLS:
                raise ValueError(f"the map has {ny} x {nx} cells, but lists {end - begin} known ones")
            for array in self.cells.values():
                refuse_expanding(self.folder, array, begin, end)
            read = {name: np.asarray(array[begin:end]) for name, array in self.cells.items()}
            if len(read["place"]) and not 0 <= read["place"].min() <= read["place"].max() < ny * nx:
                raise ValueError(f"a cell lies outside the map of {ny} x {nx} cells")
        except (OSError, ValueError, zstd.ZstdError) as error:
            how = "delete its drive and run `offpiste extract` again"
            raise DatasetError(f"snapshot {number} is damaged ({error})", where=self.folder, how=how) from error
        return CellList(self.origin[number], self.resolution, (ny, nx), **read)

    def load(self, number: int) -> TerrainMap:
        """Read the map of snapshot `number`."""
        return self.known_cells(number).terrain_map()


def open_snapshots(folder: Path) -> Snapshots:
    """Open snapshots of a `SnapshotWriter`; raise `KeyError`, `OSError` or `ValueError` if the folder is incomplete."""
    group = open_stored(folder)
    arrays = dict(group.arrays())
    for name, array in arrays.items():
        if array.nchunks_initialized < array.nchunks:
            raise ValueError(f"a chunk of the snapshots' '{name}' is missing")  # Zarr would read zeros
    index, cells = {name: np.asarray(arrays[name][...]) for name in _INDEX}, {name: arrays[name] for name in _CELLS}
    about = {name: group.attrs[name] for name in ("resolution", "latency")}
    first = index["first"]
    rising = len(first) == len(index["row"]) + 1 and bool((np.diff(first) >= 0).all()) and first[0] == 0
    if not rising or any(array.shape[0] != first[-1] for array in cells.values()):
        raise ValueError("the snapshots' cells do not fit their numbers")
    if not all(isinstance(value, float) for value in about.values()):
        raise ValueError("the snapshots have no resolution or latency")
    return Snapshots(folder, **about, **index, cells=cells)  # type: ignore[arg-type]
