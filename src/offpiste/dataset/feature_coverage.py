"""Coverage of visual features: valid rates, distances and differences by feature set, pooled over drives.

Each cell counts once per pass. The paper's numbers are in its section "Learning Distance-Independent Compression".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.feature_sets import DISTANCES, TOLERANCE
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.wheel_passes import Passes

PAPER_RATES: Final = (1.0, 0.87, 0.92, 0.92, 0.84, 0.65, 0.42, 0.21)
"""Valid rates by feature set in the paper ("occlusion percentages")."""

CENTRAL: Final = (1.0, 99.0)  # percentiles of a feature's range, robust against a few cells

HINDSIGHT: Final = FEATURE_SETS.index("hindsight")


@dataclass(frozen=True)
class Differences:
    """Differences of cells between feature sets in which both are valid; NaN without such cells."""

    count: Int[np.ndarray, "D D"]  # number of cells
    length: Float[np.ndarray, "D D"]  # mean l2 norm of the difference, divided by the l2 norm of the features' ranges
    # mean absolute difference of each feature, divided by its range; NaN for constant features
    feature: Float[np.ndarray, "D D F"]

    def neighbours(self) -> Float[np.ndarray, "_ F"]:
        """Return differences between adjacent distances: -20 and -10, -10 and 0, ..."""
        at = np.arange(HINDSIGHT + 1, len(self.count) - 1)
        return self.feature[at, at + 1]


def valid_rates(cells: Sequence[Cells], reached: Sequence[Bool[np.ndarray, "D _"]] | None = None) -> np.ndarray:
    """Return the share of cells with features by set [D], of all or those `reached` in each set; NaN without cells."""
    wanted = [np.ones_like(c.valid) for c in cells] if reached is None else reached
    result = sum((c.valid & a).sum(axis=1) for c, a in zip(cells, wanted, strict=True))
    with np.errstate(invalid="ignore"):
        return np.asarray(result / sum(a.sum(axis=1) for a in wanted))


def in_hindsight(cells: Sequence[Cells]) -> list[Bool[np.ndarray, "D _"]]:
    """Return the mask of cells with features in hindsight, for every set, as in the paper."""
    return [np.repeat(c.valid[HINDSIGHT][None], len(c.valid), axis=0) for c in cells]


def within_reach(
    passes: Passes, time: Float[np.ndarray, " N"], xy: Float[np.ndarray, "N 2"], resolution: float
) -> Bool[np.ndarray, "D P"]:
    """Return whether the vehicle was at the set's distance from the cell during the pass; always true in hindsight.

    Args:
        time, xy: times [s] and positions of the pose point in the world frame, NaN where unknown [m].
        resolution: size of a cell [m].
    """
    centre = (passes.cell + 0.5) * resolution
    reached = np.ones((len(FEATURE_SETS), len(centre)), bool)
    for first in range(0, len(centre), 1000):
        of = slice(first, first + 1000)
        away = np.linalg.norm(centre[of, None] - xy, axis=2)
        signed = np.where(time > passes.contact[of, None], -away, away)
        mine = (time >= passes.approach[of, None]) & (time < passes.end[of, None])
        for number, distance in enumerate(DISTANCES, start=1):
            with np.errstate(invalid="ignore"):
                near = np.abs(signed - distance) <= TOLERANCE
            reached[number, of] = (near & mine).any(axis=1)
    return reached


def observation_quartiles(cells: Sequence[Cells]) -> Float[np.ndarray, "D 3"]:
    """Return quartiles of the observation distances of valid features by set; NaN without any [m]."""
    quartiles = np.full((len(FEATURE_SETS), 3), np.nan)
    for number in range(len(FEATURE_SETS)):
        seen = np.concatenate([c.distance[number][c.valid[number]] for c in cells])
        if len(seen):
            quartiles[number] = np.percentile(seen, (25, 50, 75))
    return quartiles


def feature_range(cells: Sequence[Cells], percentiles: tuple[float, float] = CENTRAL) -> Float[np.ndarray, " F"]:
    """Return the range of each feature over valid cells in hindsight between two percentiles; NaN without cells.

    The paper uses the total range, (0.0, 100.0).
    """
    seen = _seen(cells)
    if not len(seen):
        return np.full(seen.shape[1], np.nan)
    low, high = np.percentile(seen, percentiles, axis=0)
    return np.asarray(high - low, np.float64)


def differences(cells: Sequence[Cells], span: Float[np.ndarray, " F"]) -> Differences:
    """Return the differences between every two sets, relative to the features' ranges (`feature_range`)."""
    sets = len(FEATURE_SETS)
    count, length = np.zeros((sets, sets), np.int64), np.zeros((sets, sets))
    feature = np.zeros((sets, sets, len(span)))
    for drive in cells:
        features = drive.features.astype(np.float32)
        for a, b in np.ndindex(sets, sets):
            both = drive.valid[a] & drive.valid[b]
            apart = features[a, both] - features[b, both]
            count[a, b] += len(apart)
            length[a, b] += np.linalg.norm(apart, axis=1).sum()
            feature[a, b] += np.abs(apart).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        each = feature / count[..., None] / np.where(span > 0, span, np.nan)
        return Differences(count, length / count / np.linalg.norm(span), each)


def unrelated(cells: Sequence[Cells], span: Float[np.ndarray, " F"], rng: np.random.Generator) -> float:
    """Return the relative mean l2 difference between random pairs of cells in hindsight, as a reference."""
    seen = _seen(cells)
    if len(seen) < 2:
        return float("nan")
    other = (np.arange(len(seen)) + rng.integers(1, len(seen), len(seen))) % len(seen)
    return float(np.linalg.norm(seen - seen[other], axis=1).mean() / np.linalg.norm(span))


def _seen(cells: Sequence[Cells]) -> Float[np.ndarray, "n F"]:
    """Return all valid features in hindsight."""
    return np.concatenate([c.features[HINDSIGHT][c.valid[HINDSIGHT]] for c in cells]).astype(np.float32)
