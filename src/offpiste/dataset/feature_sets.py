"""Feature sets: values of the map by viewing distance, and the choice of sets in training."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import DatasetError
from offpiste.dataset.wheel_passes import Passes
from offpiste.mapping.voxels_to_layers import MapCells
from offpiste.native.threads import single_threaded_torch

TOLERANCE = 5.0  # largest difference between the distance of a feature set and the vehicle's at recording [m]

DISTANCES = np.array([float(name) for name in FEATURE_SETS[1:]])
"""Distances of the feature sets, hindsight excluded [m]."""


@dataclass(frozen=True)
class FeatureSetChoice:
    """Feature sets of a batch of windows."""

    features: Int[np.ndarray, "B R"]  # set of features by window and row t-10 ... t+T-1, or one column for all rows
    normals: Int[np.ndarray, " B"]  # set of surface normals by window

    def __getitem__(self, windows: slice) -> "FeatureSetChoice":
        """Return the choice of some windows."""
        return FeatureSetChoice(self.features[windows], self.normals[windows])


def same_feature_set(count: int, number: int) -> FeatureSetChoice:
    """Return the choice of one set for all windows."""
    return FeatureSetChoice(np.full((count, 1), number), np.full(count, number))


def set_number(name: str, stored: int) -> int:
    """Return the number of a feature set in a dataset with `stored` sets; raise `DatasetError` without such a set."""
    if name not in FEATURE_SETS:
        raise DatasetError(f"no feature set '{name}'", how=f"sets are {', '.join(FEATURE_SETS)}")
    number = FEATURE_SETS.index(name)
    if number >= stored:
        how = "extract visual features (`extract --pca`)"
        raise DatasetError(f"has no feature sets by distance, so no set '{name}'", how=how)
    return number


Draw = Callable[[np.random.Generator, Int[np.ndarray, " B"], int], FeatureSetChoice]
"""Choice of sets from a generator, the sets of the windows' normals, and the number of stored sets."""


def hindsight(rng: np.random.Generator, normals: Int[np.ndarray, " B"], stored: int) -> FeatureSetChoice:
    """Choose hindsight for features (`df`, `cf`, and `b`, which reads none)."""
    return FeatureSetChoice(np.zeros((len(normals), 1), int), normals)


def per_trajectory(rng: np.random.Generator, normals: Int[np.ndarray, " B"], stored: int) -> FeatureSetChoice:
    """Choose the set of the normals for features (`dc`)."""
    return FeatureSetChoice(normals[:, None], normals)


def hindsight_throughout(rng: np.random.Generator, normals: Int[np.ndarray, " B"], stored: int) -> FeatureSetChoice:
    """Choose hindsight for features and normals, as in the paper (`b-hindsight`)."""
    return same_feature_set(len(normals), 0)


def drawn(draw: Draw, rng: np.random.Generator, count: int, stored: int) -> FeatureSetChoice:
    """Draw the sets of `count` training windows.

    All models get the same normals from generators in the same state: further draws use a spawned generator.
    """
    normals = rng.integers(0, stored, count)
    return draw(rng.spawn(1)[0], normals, stored)


Read = Callable[[Int[np.ndarray, "K 2"]], MapCells]
"""Function that reads cells (column, row on the world-aligned grid) of the current map."""


class FeatureSetRecorder:
    """Recorder of the values of a growing map for every pass and feature set.

    The set of distance d holds the value, valid or not, at the update when the horizontal distance from the pose point
    to the cell's centre, negative after first contact, was nearest to d and within `TOLERANCE`. Hindsight holds the
    last known features, elevation and normal before the cell leaves the map or the next pass over it begins. Cells of
    `resolution` [m] are on the map up to `reach` from the vehicle, in x and in y [m].
    """

    def __init__(self, passes: Passes, *, resolution: float, reach: float, features: int) -> None:
        count, sets = len(passes.contact), len(FEATURE_SETS)
        self._passes, self._reach = passes, reach
        self._x, self._y = np.ascontiguousarray((passes.cell.T + 0.5) * resolution)
        self._left = np.zeros(count, bool)  # cells that left the map after contact
        self._nearest = np.full((sets, count), np.inf)
        self.features = np.full((sets, count, features), np.nan, np.float16)
        self.valid = np.zeros((sets, count), bool)
        self.distance = np.full((sets, count), np.nan, np.float32)
        self.elevation = np.full((sets, count), np.nan, np.float32)
        self.normal = np.full((sets, count, 3), np.nan, np.float32)

    def update(self, time: float, xy: Float[np.ndarray, " 2"], read: Read) -> None:
        """Record the map after a scan at a time [s], with the pose point at xy [m]."""
        import torch  # imported here to keep imports quick; NumPy takes ten times as long to round to float16

        active, signed = self._active(time, xy)
        if not len(active):
            return
        there = read(self._passes.cell[active])
        with single_threaded_torch():
            halves = torch.from_numpy(np.ascontiguousarray(there.features, np.float32)).half().numpy()
        there = there._replace(features=halves)

        def keep(number: int, some: np.ndarray, *names: str) -> None:
            for name in names:
                getattr(self, name)[number][active[some]] = getattr(there, name)[some]

        for number, distance in enumerate(DISTANCES, 1):
            miss = np.abs(signed - distance)
            some = np.flatnonzero(miss <= TOLERANCE)
            some = some[miss[some] < self._nearest[number, active[some]]]
            self._nearest[number, active[some]] = miss[some]
            keep(number, some, "features", "valid", "distance", "elevation", "normal")
        x, y, z = there.normal.T
        keep(0, np.flatnonzero(there.valid), "features", "valid", "distance")
        keep(0, np.flatnonzero(np.isfinite(there.elevation)), "elevation")
        keep(0, np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(z)), "normal")

    def _active(
        self, time: float, xy: Float[np.ndarray, " 2"]
    ) -> tuple[Int[np.ndarray, " K"], Float[np.ndarray, " K"]]:
        """Return the passes to record, and their cells' distances, negative after contact [m]."""
        passes = self._passes
        near = np.flatnonzero((passes.approach <= time) & (time < passes.end) & ~self._left)
        dx, dy, after = self._x[near] - xy[0], self._y[near] - xy[1], time > passes.contact[near]
        inside = (np.abs(dx) <= self._reach) & (np.abs(dy) <= self._reach)
        self._left[near[after & ~inside]] = True
        away = np.sqrt(dx[inside] ** 2 + dy[inside] ** 2)
        return near[inside], np.where(after[inside], -away, away)
