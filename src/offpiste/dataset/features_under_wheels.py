"""Features and surface normals under the wheels by feature set, read from disk on demand."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Bool, Float, Float16, Float32, Int, Int32
from torch import Tensor

from offpiste.core.state import Terrain
from offpiste.dataset.feature_sets import FeatureSetChoice

MOSTLY: Final = 0.95
"""Share of touched cells among those read, above which dropping the others takes longer than keeping them."""


def to_device(array: np.ndarray, device: torch.device) -> Tensor:
    """Move an array to a device; to a GPU asynchronously from pinned memory."""
    tensor = torch.from_numpy(array)
    return tensor.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else tensor.to(device)


def rows_from(start: Int[np.ndarray, " B"], count: int, device: torch.device) -> Int[Tensor, "B R"]:
    """Return R = `count` rows from `start`, counted on the device to keep the transfer small."""
    return torch.from_numpy(start).to(device)[:, None] + torch.arange(count, device=device)


class ArrayReader:
    """Reader of pieces [d, first:end] of an array [D, M, ...].

    Memory-mapped arrays are read with `preadv`, because touched pages of the mapping would stay resident.
    """

    def __init__(self, array: np.ndarray) -> None:
        self._array = array
        self._row = array.strides[1] if array.ndim > 1 else 0
        self._file = -1
        if isinstance(array, np.memmap) and array.flags.c_contiguous and array.filename is not None:
            self._file = os.open(array.filename, os.O_RDONLY)

    def __del__(self) -> None:
        if getattr(self, "_file", -1) >= 0:
            os.close(self._file)

    def read(self, lead: int, first: int, out: np.ndarray) -> None:
        """Fill `out` [end - first, ...] with rows of the part `lead`, starting at `first`.

        Raises:
            EOFError: the file is cut short.
        """
        if self._file < 0 or not out.flags.c_contiguous or not out.size:
            out[...] = self._array[lead, first : first + len(out)]
            return
        assert isinstance(self._array, np.memmap)
        view = out.data.cast("B")
        place = self._array.offset + lead * self._array.strides[0] + first * self._row
        while len(view):
            count = os.preadv(self._file, [view], place)
            if not count:
                raise EOFError(f"{self._array.filename} is cut short")
            view, place = view[count:], place + count


@dataclass(frozen=True)
class Cells:
    """Ground cells touched by the wheels of a drive, numbered by first visit; all but `index` by feature set.

    Attributes:
        index: cell under each wheel at each row; -1 outside the map.
        valid: whether a cell has features.
        distance: from sensor to point at observation [m]; NaN where unknown.
        elevation: of the ground [m]; NaN where unknown.
    """

    index: Int32[np.ndarray, "N 4"]
    features: Float16[np.ndarray, "D M F"]
    valid: Bool[np.ndarray, "D M"]
    distance: Float32[np.ndarray, "D M"]
    elevation: Float32[np.ndarray, "D M"]


@dataclass(frozen=True)
class FeaturesUnderWheels:
    """Features of the ground cells that a batch of windows touches, each cell once, and a few cells in between.

    Attributes:
        features: of the cells; the last row, all NaN, stands for wheels outside the map.
        valid: whether a cell has features.
        past, ahead: row of the cell under each wheel at rows t-10 ... t-1 and t ... t+T-1 of the windows.
    """

    features: Float[Tensor, "M F"]
    valid: Bool[Tensor, " M"]
    past: Int[Tensor, "B H 4"]
    ahead: Int[Tensor, "B T 4"]


class CellTable:
    """Cells of all drives, in the order of their rows, with features read on demand."""

    def __init__(self, cells: list[Cells], device: torch.device) -> None:
        sizes = [c.features.shape[1] for c in cells]
        self._first = np.cumsum([0, *sizes])
        self._index = np.concatenate(
            [np.where(c.index < 0, -1, c.index + n) for c, n in zip(cells, self._first[:-1], strict=True)],
            dtype=np.int32 if self._first[-1] < 1 << 28 else np.int64,  # numbers of cells of several sets are larger
            casting="same_kind",
        )
        self._valid = np.concatenate([c.valid for c in cells], axis=1)
        self._readers = [ArrayReader(c.features) for c in cells]
        self._channels, self._device = cells[0].features.shape[2], device

    @property
    def sets(self) -> int:
        """Number of feature sets."""
        return len(self._valid)

    def under(
        self, start: Int[np.ndarray, " B"], count: int, feature_set_choice: FeatureSetChoice, history: int = 0
    ) -> FeaturesUnderWheels:
        """Return features of the cells under the wheels at `count` rows from `start`, `history` of them past."""
        cell: Int[np.ndarray, "B R 4"] = self._index[start[:, None] + np.arange(count)]
        sets = np.broadcast_to(feature_set_choice.features[..., None], cell.shape)
        known = cell >= 0
        place, ranges, total = _merged(cell, feature_set_choice.features, self.sets, int(self._first[-1]))
        number = np.where(known, cell + place[np.arange(len(start))[:, None, None], sets], total)
        touched = np.zeros(total + 1, bool)
        touched[number] = True
        touched[-1] = True
        features = np.empty((total + 1, self._channels), np.float16)
        features[-1] = np.nan  # the ranges fill all others
        valid = np.zeros(total + 1, bool)
        for chosen, first, low, size in ranges:
            self._read(features[first : first + size], valid[first : first + size], chosen, low)
        if touched.mean() < MOSTLY:
            number, features, valid = (np.cumsum(touched) - 1)[number], features[touched], valid[touched]
        under = to_device(number, self._device)
        return FeaturesUnderWheels(
            to_device(features, self._device).float(),
            to_device(valid, self._device),
            under[:, :history],
            under[:, history:],
        )

    def _read(self, features: np.ndarray, valid: np.ndarray, chosen: int, low: int) -> None:
        drive = int(np.searchsorted(self._first, low, side="right")) - 1
        self._readers[drive].read(chosen, low - int(self._first[drive]), features)
        valid[:] = self._valid[chosen, low : low + len(valid)]


def _merged(
    cell: Int[np.ndarray, "B R 4"], sets: Int[np.ndarray, "B S"], stored: int, cells: int
) -> tuple[Int[np.ndarray, "B D"], list[tuple[int, int, int, int]], int]:
    """Merge the ranges of cells that windows touch, so that each cell is read once.

    Returns:
        Offset from a cell's number to its row among the cells read, by window and set; ranges as (set, first row,
        first cell, count); number of cells read.
    """
    windows = len(cell)
    known = cell >= 0
    low = np.where(known, cell, cells).min(axis=(1, 2))
    end = np.where(known, cell, -1).max(axis=(1, 2)) + 1
    used = np.zeros((windows, stored), bool)
    used[np.arange(windows)[:, None], sets] = True
    used &= (end > 0)[:, None]
    window, chosen = np.nonzero(used)
    place = np.zeros((windows, stored), np.int64)
    if not len(window):
        return place, [], 0
    # Cells of different sets are kept apart by counting on from set to set; ranges of different drives never overlap.
    begin, stop = low[window] + chosen * cells, end[window] + chosen * cells
    order = np.argsort(begin, kind="stable")
    begin, stop = begin[order], np.maximum.accumulate(stop[order])
    new = np.concatenate(([True], begin[1:] >= stop[:-1]))
    group = np.cumsum(new) - 1
    starts = begin[new]
    sizes = stop[np.append(np.flatnonzero(new)[1:] - 1, len(stop) - 1)] - starts
    first = np.cumsum(sizes) - sizes
    place[window[order], chosen[order]] = (first - starts % cells)[group]
    ranges = zip((starts // cells).tolist(), first.tolist(), (starts % cells).tolist(), sizes.tolist(), strict=True)
    return place, list(ranges), int(sizes.sum())


class NormalsUnderWheels:
    """Surface normals of all drives, resident on the device or read on demand.

    Args:
        normals: [D, N, 4, 3] of the drives, in the order of their rows; NaN where unknown.
        resident: always true for a single feature set.
    """

    def __init__(self, normals: Sequence[np.ndarray], device: torch.device, *, resident: bool = False) -> None:
        self._arrays, self._device = normals, device
        self._first = np.cumsum([0, *(n.shape[1] for n in normals)])
        self._readers = [ArrayReader(n) for n in normals]
        resident = resident or len(normals[0]) == 1
        self._values = (
            torch.cat([torch.from_numpy(np.array(n)).to(device) for n in normals], dim=1) if resident else None
        )

    def whole(self) -> Float[Tensor, "N 4 3"]:
        """Return normals of the first feature set at every row."""
        if self._values is not None:
            return self._values[0]
        return torch.as_tensor(np.concatenate([n[0] for n in self._arrays]), device=self._device)

    def at(self, start: Int[np.ndarray, " B"], count: int, sets: Int[np.ndarray, " B"]) -> Float[Tensor, "B R 4 3"]:
        """Return normals at R = `count` rows from `start`, with a feature set per window."""
        if self._values is not None:
            chosen = torch.from_numpy(np.ascontiguousarray(sets)).to(self._device)
            return self._values[chosen[:, None], rows_from(start, count, self._device)]
        result = np.empty((len(start), count, 4, 3), np.float32)
        drive = np.searchsorted(self._first, start, side="right") - 1
        first = (start - self._first[drive]).tolist()
        for window, number in enumerate(drive.tolist()):
            self._readers[number].read(int(sets[window]), first[window], result[window])
        return to_device(result, self._device)


class LevelNormals:
    """Level ground in place of `NormalsUnderWheels`."""

    def __init__(self, device: torch.device) -> None:
        self._up = torch.tensor([0.0, 0.0, 1.0], device=device)

    def whole(self) -> Float[Tensor, "N 4 3"]:
        """Return no normals."""
        return self._up.expand(0, 4, 3)

    def at(self, start: Int[np.ndarray, " B"], count: int, sets: Int[np.ndarray, " B"]) -> Float[Tensor, "B R 4 3"]:
        """Return vertical normals at R = `count` rows."""
        return self._up.expand(len(start), count, 4, 3)

    @staticmethod
    def terrain(normal: Float[Tensor, "*S 4 3"]) -> Terrain:
        """Return `Terrain.of` the normals of `at` without checking them."""
        return Terrain(normal, normal.new_ones((), dtype=torch.bool).expand(normal.shape[:-1]), normal[..., :0])
