"""The map as it was when a window starts, for windows of validation and test: what a planner would have read.

A snapshot is cropped to what five seconds can reach and holds only cells of which something is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr
from jaxtyping import Bool, Float, Float16, Float32, Int, Int32
from scipy.spatial.distance import cdist
from torch import Tensor
from zarr.codecs import Crc32cCodec, ZstdCodec

from offpiste.conventions import DT, HORIZON_STEPS, PERCEPTION_LATENCY
from offpiste.errors import DatasetError
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.mapping.terrain_sampler import CellStack, last_cells

CELL_ARRAYS = ("place", "elevation", "rise", "features")
"""Arrays of a `CellList`; on disk those of all snapshots lie one after the other."""

CHUNK = 8192
"""Cells in a chunk of the store; a snapshot has some ten thousand."""


@dataclass(frozen=True)
class SnapshotSettings:
    """Which windows get a snapshot, and how far it reaches.

    Attributes:
        seconds: least time between two snapshots of a part [s].
        parts: whose windows get one; training needs none.
        most: snapshots of one part of one drive; a longer part has them further apart.
        margin: the map is kept within this and half the way of five seconds at the window's first speed, around the
            place half that way straight ahead [m].
        latency: the map holds what was measured this long before the window's start, or earlier [s].
        min_speed: windows that start above it get one [m/s], 0: standstills as well; None: as the dataset's windows.

    Raises:
        DatasetError: the latency is no time from 0 to 1 s, or `seconds` or the speed none of 0 or more.
    """

    seconds: float = 0.5
    parts: tuple[str, ...] = ("validation", "test")
    most: int = 2000
    margin: float = 18.0
    latency: float = PERCEPTION_LATENCY
    min_speed: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.latency <= 1:
            raise DatasetError(f"a latency of {self.latency:g} s", how="give a time from 0 to 1")
        if not 0 <= self.seconds < np.inf:
            raise DatasetError(f"a snapshot every {self.seconds:g} s", how="give a time of 0 or more")
        if self.min_speed is not None and not 0 <= self.min_speed < np.inf:
            raise DatasetError(f"snapshots above {self.min_speed:g} m/s", how="give a speed of 0 or more")


@dataclass(frozen=True)
class CellList:
    """The known cells of a map.

    Attributes:
        origin: x, y of the centre of cell [0, 0] of the map [m].
        shape: rows and columns of the map.
        place: row * columns + column.
        elevation: [m].
        rise: towards +x and +y; NaN where unknown.
        features: NaN where missing.
    """

    origin: Float[np.ndarray, " 2"]
    shape: tuple[int, int]
    place: Int32[np.ndarray, " C"]
    elevation: Float32[np.ndarray, " C"]
    rise: Float16[np.ndarray, "C 2"]
    features: Float16[np.ndarray, "C F"]

    def terrain_map(self, resolution: float) -> TerrainMap:
        """The map again, NaN in all other cells."""
        ny, nx = self.shape

        def spread(values: np.ndarray) -> np.ndarray:
            full = np.full((ny * nx, *values.shape[1:]), np.nan, values.dtype)
            full[self.place] = values
            return full.reshape(ny, nx, *values.shape[1:])

        rise = spread(self.rise)
        return TerrainMap(self.origin, resolution, spread(self.elevation), spread(self.features), rise)

    def near(self, path: Float[np.ndarray, "P 2"], margin: float, resolution: float) -> "CellList":
        """The cells within `margin` of the points of a path, on a grid that is no larger than they need.

        Args:
            path: x, y in the world frame [m].
            margin, resolution: [m].
        """
        cell = np.stack(np.divmod(self.place, self.shape[1]), axis=-1)
        kept = cdist(self.origin + resolution * cell[:, ::-1], path).min(axis=1) <= margin
        low = cell[kept].min(axis=0, initial=max(self.shape))
        ny, nx = (cell[kept].max(axis=0, initial=0) - low + 1).clip(min=1).tolist()
        place = ((cell[kept] - low) @ [nx, 1]).astype(np.int32)
        origin = self.origin + resolution * low[::-1]
        return CellList(origin, (ny, nx), place, self.elevation[kept], self.rise[kept], self.features[kept])


def stack_cells(cells: Sequence[CellList], resolution: float, *, device: torch.device | str = "cpu") -> CellStack:
    """Maps as tensors, for lookups."""
    ny, nx = (max(c.shape[axis] for c in cells) for axis in (0, 1))
    place = np.full((len(cells), ny, nx), -1, np.int32)
    first = np.cumsum([0] + [len(c.place) for c in cells])
    for number, known in enumerate(cells):
        place[number, *np.divmod(known.place, known.shape[1])] = first[number] + np.arange(len(known.place))

    def listed(parts: Sequence[np.ndarray]) -> Tensor:
        nothing = np.full((1, parts[0].shape[1]), np.nan, parts[0].dtype)
        return torch.from_numpy(np.concatenate([*parts, nothing])).to(device)

    return CellStack(
        resolution,
        torch.as_tensor(np.stack([c.origin for c in cells]), dtype=torch.float64).to(device),
        last_cells([c.shape for c in cells]).to(device),
        torch.from_numpy(place).to(device),
        listed([c.rise for c in cells]),
        listed([c.features for c in cells]),
    )


class SnapshotSchedule:
    """Decides at which rows a snapshot is taken, as a drive is replayed.

    Args:
        starts: for each part that is evaluated, the rows at which its windows start.
    """

    def __init__(self, starts: Sequence[Bool[np.ndarray, " N"]], settings: SnapshotSettings) -> None:
        self._starts = starts
        self._apart = [max(settings.seconds / DT, part.sum() / settings.most) for part in starts]
        self._latest = [-np.inf] * len(starts)

    def at(self, row: int) -> bool:
        """Whether one is wanted at `row`; rows must rise from call to call."""
        for part, starts in enumerate(self._starts):
            if 0 <= row < len(starts) and starts[row] and row - self._latest[part] >= self._apart[part]:
                self._latest[part] = row
                return True
        return False


def crop(terrain: TerrainMap, state: Float[np.ndarray, " 6"], margin: float) -> CellList:
    """The known cells of a map that a window may come to.

    Args:
        terrain: a view is enough: the values are copied.
        state: at the window's start, px and py in the world frame.
        margin: of `SnapshotSettings` [m].
    """
    half = 0.5 * HORIZON_STEPS * DT * float(np.hypot(state[3], state[4]))
    centre = state[:2] + half * np.array([np.cos(state[2]), np.sin(state[2])])
    near = terrain.cropped(centre - half - margin, centre + half + margin)
    ny, nx = near.elevation.shape
    y, x = (near.origin[1 - axis] + near.resolution * np.arange(n) for axis, n in enumerate((ny, nx)))
    reached = np.hypot(x[None] - centre[0], y[:, None] - centre[1]) <= half + margin
    row, column = np.nonzero(reached & np.isfinite(near.elevation))
    assert near.rise is not None
    return CellList(
        near.origin,
        (ny, nx),
        (row * nx + column).astype(np.int32),
        near.elevation[row, column].astype(np.float32),
        near.rise[row, column].astype(np.float16),
        near.features[row, column].astype(np.float16),
    )


class SnapshotWriter:
    """Writes snapshots of one drive into a new folder, one after the other, so that none stays in memory.

    Args:
        folder: of a Zarr group.
        resolution: of the maps [m].
        features: F.
        latency: of `SnapshotSettings` [s].
    """

    def __init__(self, folder: Path, resolution: float, features: int, latency: float = PERCEPTION_LATENCY) -> None:
        self._group = zarr.open_group(
            folder, mode="w", attributes={"resolution": resolution, "latency": latency}, zarr_format=3
        )
        self._row: list[int] = []
        self._first = [0]
        self._origin: list[np.ndarray] = []
        self._shape: list[tuple[int, int]] = []
        # Not looked up in the group again: that would forget to write chunks of nothing but zeros.
        self._cells = {
            name: self._group.create_array(
                name,
                shape=(0, *more),
                dtype=dtype,
                chunks=(CHUNK, *more),
                compressors=[ZstdCodec(level=1), Crc32cCodec()],
                config={"write_empty_chunks": True},
            )
            for name, dtype, more in (
                ("place", np.int32, ()),
                ("elevation", np.float32, ()),
                ("rise", np.float16, (2,)),
                ("features", np.float16, (features,)),
            )
        }

    def add(self, row: int, cells: CellList) -> None:
        """A snapshot for the window that starts at `row` of its drive."""
        for name, array in self._cells.items():
            array.append(getattr(cells, name))
        self._row.append(row)
        self._first.append(self._first[-1] + len(cells.place))
        self._origin.append(cells.origin)
        self._shape.append(cells.shape)

    def close(self) -> None:
        """Write what finds them again."""
        for name, values in (
            ("row", np.array(self._row, np.int64)),
            ("first", np.array(self._first, np.int64)),
            ("origin", np.array(self._origin, np.float64).reshape(-1, 2)),
            ("shape", np.array(self._shape, np.int64).reshape(-1, 2)),
        ):
            self._group.create_array(name, data=values, compressors=Crc32cCodec(), config={"write_empty_chunks": True})


@dataclass(frozen=True)
class Snapshots:
    """Snapshots of one drive, read when windows need them.

    Attributes:
        folder: where they are stored.
        resolution: of the maps [m].
        latency: from their last measurement to the start of their windows, at least [s].
        row: at which windows they were taken, rising.
        first: of the cells of each, and how many there are in all.
        origin, shape: of each.
        cells: `CellList.place`, `elevation`, `rise` and `features` of all, on disk.
    """

    folder: Path
    resolution: float
    latency: float
    row: Int[np.ndarray, " S"]
    first: Int[np.ndarray, " S+1"]
    origin: Float[np.ndarray, "S 2"]
    shape: Int[np.ndarray, "S 2"]
    cells: dict[str, Any]

    def known_cells(self, number: int) -> CellList:
        """The known cells of snapshot `number`.

        Raises:
            DatasetError: what is stored of it is damaged.
        """
        begin, end = self.first[number : number + 2]
        ny, nx = self.shape[number].tolist()
        try:
            read = {name: np.asarray(array[begin:end]) for name, array in self.cells.items()}
        except (OSError, ValueError) as error:
            raise DatasetError(
                f"snapshot {number} is damaged ({error})",
                where=self.folder,
                how="delete its drive and run `offpiste extract` again",
            ) from error
        return CellList(self.origin[number], (ny, nx), **read)

    def load(self, number: int) -> TerrainMap:
        """The map of snapshot `number`."""
        return self.known_cells(number).terrain_map(self.resolution)


def open_snapshots(folder: Path) -> Snapshots:
    """Snapshots that a `SnapshotWriter` wrote.

    Raises:
        KeyError, OSError, ValueError: the folder is cut short.
    """
    group = zarr.open_group(folder, mode="r")
    arrays = dict(group.arrays())
    for name, array in arrays.items():
        if array.nchunks_initialized < array.nchunks:
            # Zarr would read a missing chunk as zeros.
            raise ValueError(f"a chunk of the snapshots' '{name}' is missing")
    row, first, origin, shape = (np.asarray(arrays[name][...]) for name in ("row", "first", "origin", "shape"))
    resolution, latency = group.attrs["resolution"], group.attrs["latency"]
    assert isinstance(resolution, float)
    assert isinstance(latency, float)
    cells = {name: arrays[name] for name in CELL_ARRAYS}
    return Snapshots(folder, resolution, latency, row, first, origin, shape, cells)
