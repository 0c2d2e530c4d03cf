"""Features and surface normals under the wheels by feature set, read from disk on demand."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Bool, Float, Float16, Float32, Int, Int32
from torch import Tensor

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


@dataclass(frozen=True)
class Cells:
    """Ground cells touched by the wheels during a drive, numbered in order of first contact.

    All arrays except `index` have a leading feature-set axis.
    """

    index: Int32[np.ndarray, "N 4"]  # cell under each wheel at each row; -1 outside the map
    features: Float16[np.ndarray, "D M F"]
    valid: Bool[np.ndarray, "D M"]  # whether a cell has features
    distance: Float32[np.ndarray, "D M"]  # from sensor to point at observation [m]; NaN where unknown
    elevation: Float32[np.ndarray, "D M"]  # of the ground [m]; NaN where unknown


def joined_index(cells: Sequence[Cells]) -> tuple[Int[np.ndarray, "N 4"], Int[np.ndarray, " _"]]:
    """Return the indices of all drives with cells numbered on from drive to drive, and the first cell of each."""
    first = np.cumsum([0, *(c.features.shape[1] for c in cells)])
    index = [np.where(c.index < 0, -1, c.index + begin) for c, begin in zip(cells, first[:-1], strict=True)]
    return np.concatenate(index), first


@dataclass(frozen=True)
class FeaturesUnderWheels:
    """Features of the ground cells that a batch of windows touches, each cell once, and a few cells in between."""

    features: Float[Tensor, "M F"]  # the last row, all NaN, stands for wheels outside the map
    valid: Bool[Tensor, " M"]  # whether a cell has features
    past: Int[Tensor, "B H 4"]  # row of `features` under each wheel at rows t-10 ... t-1 of the windows
    ahead: Int[Tensor, "B T 4"]  # at rows t ... t+T-1


class CellTable:
    """Cells of all drives, in the order of their rows, with features read on demand."""

    def __init__(self, cells: Sequence[Cells], device: torch.device) -> None:
        index, self._first = joined_index(cells)
        # Numbers of cells of several sets are larger.
        self._index = index.astype(np.int32 if self._first[-1] < 1 << 28 else np.int64)
        self._valid = np.concatenate([c.valid for c in cells], axis=1)
        self._features, self._device = [c.features for c in cells], device
        self.sets = len(self._valid)  # number of feature sets

    def under(
        self, start: Int[np.ndarray, " B"], count: int, feature_set_choice: FeatureSetChoice, history: int = 0
    ) -> FeaturesUnderWheels:
        """Return features of the cells under the wheels at `count` rows from `start`, `history` of them past."""
        cell: Int[np.ndarray, "B R 4"] = self._index[start[:, None] + np.arange(count)]
        sets = np.broadcast_to(feature_set_choice.features[..., None], cell.shape)
        place, ranges, total = _merged(cell, feature_set_choice.features, self.sets, int(self._first[-1]))
        number = np.where(cell >= 0, cell + place[np.arange(len(start))[:, None, None], sets], total)
        touched = np.zeros(total + 1, bool)
        touched[number] = True
        touched[-1] = True
        features = np.empty((total + 1, self._features[0].shape[2]), np.float16)
        features[-1] = np.nan  # the ranges fill all others
        valid = np.zeros(total + 1, bool)
        for chosen, row, low, size in ranges:
            drive = int(np.searchsorted(self._first, low, side="right")) - 1
            begin = low - int(self._first[drive])
            features[row : row + size] = self._features[drive][chosen, begin : begin + size]
            valid[row : row + size] = self._valid[chosen, low : low + size]
        if touched.mean() < MOSTLY:
            number, features, valid = (np.cumsum(touched) - 1)[number], features[touched], valid[touched]
        on_device = [to_device(array, self._device) for array in (features, valid, number)]
        return FeaturesUnderWheels(
            on_device[0].float(), on_device[1], on_device[2][:, :history], on_device[2][:, history:]
        )


def _merged(
    cell: Int[np.ndarray, "B R 4"], sets: Int[np.ndarray, "B S"], stored: int, cells: int
) -> tuple[Int[np.ndarray, "B D"], list[tuple[int, int, int, int]], int]:
    """Merge the ranges of cells that windows touch, so that each cell is read once.

    Returns:
        Offset from a cell's number to its row among the cells read, by window and set; ranges as (set, first row,
        first cell, count); number of cells read.
    """
    windows, known = len(cell), cell >= 0
    low = np.where(known, cell, cells).min(axis=(1, 2))
    end = np.where(known, cell, -1).max(axis=(1, 2)) + 1
    used = np.zeros((windows, stored), bool)
    used[np.arange(windows)[:, None], sets] = True
    window, chosen = np.nonzero(used & (end > 0)[:, None])
    place = np.zeros((windows, stored), np.int64)
    if not len(window):
        return place, [], 0
    # Cells of different sets are kept apart by counting on from set to set; ranges of different drives never overlap.
    begin, stop = low[window] + chosen * cells, end[window] + chosen * cells
    order = np.argsort(begin, kind="stable")
    begin, stop = begin[order], np.maximum.accumulate(stop[order])
    new = np.concatenate(([True], begin[1:] >= stop[:-1]))
    starts = begin[new]
    sizes = stop[np.append(np.flatnonzero(new)[1:] - 1, len(stop) - 1)] - starts
    first = np.cumsum(sizes) - sizes
    place[window[order], chosen[order]] = (first - starts % cells)[np.cumsum(new) - 1]
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
        self._values = None
        if resident or len(normals[0]) == 1:
            self._values = torch.cat([torch.from_numpy(np.array(n)).to(device) for n in normals], dim=1)

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
        drives = np.searchsorted(self._first, start, side="right") - 1
        for window, (drive, first) in enumerate(zip(drives, start - self._first[drives], strict=True)):
            result[window] = self._arrays[drive][sets[window], first : first + count]
        return to_device(result, self._device)
