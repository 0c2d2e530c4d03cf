"""Maps for the evaluation of predictions: one per drive, or a snapshot per window."""

from collections.abc import Sequence
from copy import copy

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import DatasetError
from offpiste.dataset.map_snapshots import CellList, stack_cells
from offpiste.dataset.store import StoredDrive
from offpiste.mapping.terrain_sampler import CellStack, MapStack, stack_maps


class WindowMaps:
    """Maps of windows at row t = `row` of drive number `drive`."""

    def __init__(
        self,
        drives: Sequence[StoredDrive],
        drive: Int[np.ndarray, " n"],
        row: Int[np.ndarray, " n"],
        device: torch.device,
    ) -> None:
        self._drives, self._drive, self._device = drives, drive, device
        self._snapshot = np.full(len(drive), -1)
        for number in np.unique(drive):
            snapshots = drives[number].snapshots
            if snapshots is not None and len(snapshots.row):
                mine = np.flatnonzero(drive == number)
                place = np.searchsorted(snapshots.row, row[mine]).clip(max=len(snapshots.row) - 1)
                self._snapshot[mine] = np.where(snapshots.row[place] == row[mine], place, -1)
        self._latest: tuple[np.ndarray, MapStack | CellStack] | None = None  # maps that were read last, by number

    def take(self, index: Int[np.ndarray, " m"]) -> "WindowMaps":
        """Return the maps of some of the windows."""
        other = copy(self)
        other._drive, other._snapshot, other._latest = self._drive[index], self._snapshot[index], None
        return other

    @property
    def snapped(self) -> Bool[np.ndarray, " n"]:
        """Mask of windows with a snapshot."""
        return np.asarray(self._snapshot >= 0)

    @property
    def any(self) -> bool:
        """Whether some windows have a snapshot, or all of their drives a map."""
        whole = all(self._drives[number].load_map is not None for number in np.unique(self._drive))
        return bool(self.snapped.any()) or (whole and not self.snapshots_elsewhere)

    @property
    def snapshots_elsewhere(self) -> bool:
        """Whether the dataset has snapshots, but none at the start of these windows."""
        snapshots = [drive.snapshots for drive in self._drives]
        return not self.snapped.any() and any(one is not None and len(one.row) > 0 for one in snapshots)

    @property
    def kept(self) -> bool:
        """Whether the dataset has maps, for these or other windows."""
        return self.any or self.snapshots_elsewhere or any(drive.load_map is not None for drive in self._drives)

    def of(self, index: Int[np.ndarray, " B"]) -> tuple[MapStack | CellStack, Int[np.ndarray, " B"]]:
        """Return maps of some windows, and the index of each window's map; -1 without a map.

        The last maps are cached: compared models read the same ones in turn.
        """
        number = np.full(len(index), -1)
        if self.snapped.any():
            have = self._snapshot[index] >= 0
            keys = np.stack((self._drive[index], self._snapshot[index]), axis=1)[have]
            different, place = np.unique(keys, axis=0, return_inverse=True)
            number[have] = place.ravel()
            if self._latest is None or not np.array_equal(self._latest[0], different):
                self._latest = None  # first, so that memory holds one stack at a time
                cells = [self._load(*key) for key in different.tolist()]
                self._latest = different, stack_cells(cells, device=self._device)
            return self._latest[1], number
        if self._latest is None:
            maps = {n: load() for n in np.unique(self._drive) if (load := self._drives[n].load_map) is not None}
            if not maps:
                name = self._drives[self._drive[0]].name
                raise DatasetError(f"drive '{name}' has no map", how="extract with --pca (see fit-pca)")
            self._latest = np.array(list(maps)), stack_maps(list(maps.values()), device=self._device)
        for one, drive in enumerate(self._latest[0]):
            number[self._drive[index] == drive] = one
        return self._latest[1], number

    def near(self, index: Int[np.ndarray, " B"], paths: Float[np.ndarray, "B P 2"], margin: float) -> CellStack:
        """Return one map for each of some windows with a snapshot: the cells within `margin` of a path [m]."""
        of = zip(self._drive[index].tolist(), self._snapshot[index].tolist(), paths, strict=True)
        cells = [self._load(drive, snapshot).near(path, margin) for drive, snapshot, path in of]
        return stack_cells(cells, device=self._device)

    def _load(self, drive: int, snapshot: int) -> CellList:
        snapshots = self._drives[drive].snapshots
        assert snapshots is not None
        return snapshots.known_cells(snapshot)
