"""The loop that keeps what a map holds of cells, by feature set; the same in plain NumPy is in tests/dataset."""

from typing import NamedTuple

import numpy as np

from offpiste.compilation import FEATURE_SETS_KEPT


class KeptValues(NamedTuple):
    """What is kept of the cells of passes for each feature set, or what a map holds of some cells now.

    Attributes:
        features: float16, as their bits [sets, P, F] or [K, F].
        valid, distance, elevation: [sets, P] or [K].
        normal: [sets, P, 3] or [K, 3].
    """

    features: np.ndarray
    valid: np.ndarray
    distance: np.ndarray
    elevation: np.ndarray
    normal: np.ndarray


@FEATURE_SETS_KEPT.loop
def keep_features(kept, number, i, values, q):  # type: ignore[no-untyped-def]
    """Keep the features of a cell, whether they are valid, and from where they were seen."""
    for k in range(values.features.shape[1]):
        kept.features[number, i, k] = values.features[q, k]
    kept.valid[number, i], kept.distance[number, i] = values.valid[q], values.distance[q]


@FEATURE_SETS_KEPT.loop
def keep_normal(kept, number, i, values, q):  # type: ignore[no-untyped-def]
    """Keep the normal of a cell."""
    for axis in range(3):
        kept.normal[number, i, axis] = values.normal[q, axis]


@FEATURE_SETS_KEPT.entry
def keep_values(active, miss, tolerance, nearest, values, kept):  # type: ignore[no-untyped-def]
    """Keep values of the active cells: in hindsight what is known, in the other sets what is nearest to their distance.

    Args:
        active: numbers of the passes whose cells were read [K].
        miss: how far each is from the distance of each set but hindsight [m] [sets - 1, K].
        tolerance: largest miss [m].
        nearest: least miss so far, hindsight's left out [m] [sets, P].
        values, kept: `KeptValues`.
    """
    for q in range(len(active)):
        i = active[q]
        for other in range(len(miss)):
            number = other + 1
            if miss[other, q] <= tolerance and miss[other, q] < nearest[number, i]:
                nearest[number, i] = miss[other, q]
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
