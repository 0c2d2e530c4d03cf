"""Feature sets: values of the map by viewing distance, and the choice of sets in training."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import DatasetError
from offpiste.dataset.wheel_passes import Passes
from offpiste.mapping.voxels_to_layers import MapCells
from offpiste.native.compilation import FEATURE_SETS_KEPT
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
        self._centre = (passes.cell + 0.5) * resolution
        self._left, self._active, self._signed = np.zeros(count, bool), np.empty(count, np.int64), np.empty(count)
        self._nearest = np.full((sets, count), np.inf)
        self.features = np.full((sets, count, features), np.nan, np.float16)
        self.valid = np.zeros((sets, count), bool)
        self.distance = np.full((sets, count), np.nan, np.float32)
        self.elevation = np.full((sets, count), np.nan, np.float32)
        self.normal = np.full((sets, count, 3), np.nan, np.float32)

    def update(self, time: float, xy: Float[np.ndarray, " 2"], read: Read) -> None:
        """Record the map after a scan at a time [s], with the pose point at xy [m]."""
        import torch  # imported here to keep imports quick; NumPy takes ten times as long to round to float16

        p, centre, x, y = self._passes, self._centre, float(xy[0]), float(xy[1])
        active, signed = self._active, self._signed
        count = put_active(time, x, y, self._reach, centre, p.approach, p.contact, p.end, self._left, active, signed)
        if not count:
            return
        active, signed = active[:count], signed[:count]
        there = read(p.cell[active])
        with single_threaded_torch():
            halves = torch.from_numpy(np.ascontiguousarray(there.features, np.float32)).half().numpy()
        values = KeptValues(halves.view(np.uint16), there.valid, there.distance, there.elevation, there.normal)
        kept = KeptValues(self.features.view(np.uint16), self.valid, self.distance, self.elevation, self.normal)
        keep_values(active, signed, DISTANCES, TOLERANCE, self._nearest, values, kept)


class KeptValues(NamedTuple):
    """Values by feature set and pass [sets, P, ...], or of K cells of the current map [K, ...]."""

    features: np.ndarray  # bits of float16 [..., F]
    valid: np.ndarray
    distance: np.ndarray
    elevation: np.ndarray
    normal: np.ndarray  # unit vectors in the world frame [..., 3]


@FEATURE_SETS_KEPT.loop
def keep_features(kept, number, i, values, q):  # type: ignore[no-untyped-def]
    """Keep features, validity and observation distance of a cell."""
    for k in range(values.features.shape[1]):
        kept.features[number, i, k] = values.features[q, k]
    kept.valid[number, i], kept.distance[number, i] = values.valid[q], values.distance[q]


@FEATURE_SETS_KEPT.loop
def keep_normal(kept, number, i, values, q):  # type: ignore[no-untyped-def]
    """Keep the normal of a cell."""
    for axis in range(3):
        kept.normal[number, i, axis] = values.normal[q, axis]


@FEATURE_SETS_KEPT.entry
def put_active(time, x, y, reach, centre, approach, contact, end, left, active, signed):  # type: ignore[no-untyped-def]
    """Write the active passes and their distances, and return their number.

    Args:
        x, y: of the pose point [m].
        reach: half the side of the map around it [m].
        centre: of the passes' cells [P, 2] [m].
        left: updated mask of cells that left the map after contact [P].
        active, signed: numbers of the passes, and distances, negative after contact [m] [P].
    """
    count = 0
    for i in range(len(centre)):
        if not approach[i] <= time < end[i]:
            continue
        dx, dy = centre[i, 0] - x, centre[i, 1] - y
        if abs(dx) > reach or abs(dy) > reach:
            left[i] |= time > contact[i]
        elif not left[i]:
            away = np.sqrt(dx * dx + dy * dy)
            active[count], signed[count] = i, -away if time > contact[i] else away
            count += 1
    return count


@FEATURE_SETS_KEPT.entry
def keep_values(active, signed, distances, tolerance, nearest, values, kept):  # type: ignore[no-untyped-def]
    """Keep known values of the active cells in hindsight, and the values nearest to each distance in the other sets.

    Args:
        active, signed: as in `put_active` [K].
        nearest: smallest miss so far, updated [m] [sets, P].
        values, kept: `KeptValues` of the cells and of the passes.
    """
    for q in range(len(active)):
        i = active[q]
        for other in range(len(distances)):
            number, miss = other + 1, abs(signed[q] - distances[other])
            if miss <= tolerance and miss < nearest[number, i]:
                nearest[number, i] = miss
                keep_features(kept, number, i, values, q)
                keep_normal(kept, number, i, values, q)
                kept.elevation[number, i] = values.elevation[q]
        if values.valid[q]:
            keep_features(kept, 0, i, values, q)
        if np.isfinite(values.elevation[q]):
            kept.elevation[0, i] = values.elevation[q]
        x, y, z = values.normal[q, 0], values.normal[q, 1], values.normal[q, 2]
        if np.isfinite(x) and np.isfinite(y) and np.isfinite(z):
            keep_normal(kept, 0, i, values, q)
