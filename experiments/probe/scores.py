"""Linear probes fitted on the cells of some drives and tested on those of others, by feature set."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from experiments.probe.cells import SeenCells
from offpiste.core.conventions import FEATURE_SETS
from offpiste.evaluation.intervals import Resampling, Sampling
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES

TARGETS = ("friction", "rolling_resistance")
TRAINED = ("hindsight", "same")
"""Feature set in training: hindsight, or the one that is tested."""
PARTS = 5
"""Parts of the cross-validation that chooses the penalty: fifths of every drive, in the order of time."""
FEWEST = 50
"""Least number of cells to fit or test on."""
PENALTIES = tuple(float(p) for p in 10.0 ** np.arange(-5, 2.1, 0.5))
"""Penalties to choose from, relative to the variance of a standardised feature."""


@dataclass(frozen=True)
class Pooled:
    """Cells of several drives, with the number of each cell's drive."""

    cells: SeenCells
    drive: Int[np.ndarray, " M"]

    @property
    def part(self) -> Int[np.ndarray, " M"]:
        """Which of `PARTS` each belongs to."""
        part = np.zeros(len(self.drive), np.int64)
        for number in np.unique(self.drive):
            mine = self.drive == number
            row = self.cells.row[mine]
            part[mine] = np.clip((row - row.min()) * PARTS // (np.ptp(row) + 1), 0, PARTS - 1)
        return part


def pool(drives: Sequence[SeenCells]) -> Pooled:
    """Put drives together."""
    joined = {
        name: np.concatenate([vars(cells)[name] for cells in drives], axis=int(name in ("features", "colour", "valid")))
        for name in vars(drives[0])
    }
    return Pooled(SeenCells(**joined), np.repeat(np.arange(len(drives)), [len(cells.row) for cells in drives]))


def _visual(cells: SeenCells, number: int) -> Float[np.ndarray, "M F"]:
    return cells.features[number].astype(np.float64)


def _brightness(cells: SeenCells, number: int) -> Float[np.ndarray, "M 1"]:
    return cells.colour[number].mean(axis=1, keepdims=True).astype(np.float64)


def _kind(cells: SeenCells, number: int) -> Float[np.ndarray, "M F"]:
    return np.eye(len(GROUND_KINDS))[cells.ground[:, : len(GROUND_KINDS)].argmax(axis=1)]


INPUTS: Mapping[str, Callable[[SeenCells, int], np.ndarray]] = {
    "visual": _visual, "brightness": _brightness, "kind": _kind,
}  # fmt: skip
"""What a probe reads in the feature set of a number; brightness is the floor, the true kind of ground the ceiling."""


@dataclass(frozen=True)
class Ridge:
    """Ridge regression y = offset + ((x - mean) / scale) weights; the scale of a constant feature is infinite."""

    mean: Float[np.ndarray, " F"]
    scale: Float[np.ndarray, " F"]
    weights: Float[np.ndarray, " F"]
    offset: float
    penalty: float

    def predict(self, features: Float[np.ndarray, "n F"]) -> Float[np.ndarray, " n"]:
        """Predicted target of each row."""
        return self.offset + ((features - self.mean) / self.scale) @ self.weights


def fit_ridge(
    x: Float[np.ndarray, "n F"],
    target: Float[np.ndarray, " n"],
    fold: Int[np.ndarray, " n"],
    penalties: tuple[float, ...] = PENALTIES,
) -> Ridge:
    """Fit on all rows with the penalty whose squared error on the folds left out is smallest.

    Args:
        fold: number of each row's part in the cross-validation; with one part only, the largest penalty is taken.
    """
    # Scaled once: features that hardly vary in some folds would otherwise be blown up there.
    scale = x.std(axis=0)
    scale = np.where(scale > 1e-9 * (1 + np.abs(x).max(axis=0)), scale, np.inf)
    error = np.zeros(len(penalties))
    for number in np.unique(fold):
        out = fold == number
        if out.all():
            break
        mean, offset, weights = _path(x[~out], target[~out], scale, penalties)
        predicted = offset + ((x[out] - mean) / scale) @ weights
        error += np.square(target[out, None] - predicted).sum(axis=0)
    best = penalties[int(error.argmin())] if error.any() else max(penalties)
    mean, offset, weights = _path(x, target, scale, (best,))
    return Ridge(mean, scale, weights[:, 0], offset, best)


def _path(
    features: Float[np.ndarray, "n F"],
    target: Float[np.ndarray, " n"],
    scale: Float[np.ndarray, " F"],
    penalties: tuple[float, ...],
) -> tuple[Float[np.ndarray, " F"], float, Float[np.ndarray, "F k"]]:
    """Mean, offset and weights w = (X'X / n + penalty I)^-1 X'y / n for each penalty, X scaled, X and y centred."""
    mean, offset = features.mean(axis=0), float(target.mean())
    x = (features - mean) / scale
    gram, moment = x.T @ x / len(x), x.T @ (target - offset) / len(x)
    values, vectors = np.linalg.eigh(gram)
    return mean, offset, vectors @ ((vectors.T @ moment)[:, None] / (values.clip(0)[:, None] + np.array(penalties)))


def r2(
    target: Float[np.ndarray, " n"], predicted: Float[np.ndarray, " n"], drawn: Resampling
) -> tuple[float, tuple[float, float]]:
    """1 - squared error / squared deviation from the mean of the test cells, and its 95 % interval.

    Args:
        drawn: resamples of the drives, and of the blocks in them, that the rows belong to.
    """
    columns = np.ones(len(target)), target, target**2, (target - predicted) ** 2
    sums = np.stack([np.bincount(drawn.block, weights=c, minlength=drawn.blocks) for c in columns])

    def share(totals: np.ndarray) -> np.ndarray:
        n, y, yy, error = totals
        spread = yy - y * y / n
        return np.where(spread > 1e-12 * yy, 1 - error / spread, np.nan)

    with np.errstate(divide="ignore", invalid="ignore"):
        return float(share(sums.sum(axis=1))), drawn.interval(share(sums @ drawn.draws.T))


def target_of(pooled: Pooled, target: str) -> Float[np.ndarray, " M"]:
    """A true property of the ground at each cell."""
    return pooled.cells.properties[:, GROUND_PROPERTIES.index(target)].astype(np.float64)


def fit_probe(pooled: Pooled, target: str, name: str, feature_set: str) -> Ridge | None:
    """A ridge from an input to a target on the valid cells of a set; None where there are too few."""
    number = FEATURE_SETS.index(feature_set)
    valid = pooled.cells.valid[number]
    if valid.sum() < FEWEST:
        return None
    return fit_ridge(INPUTS[name](pooled.cells, number)[valid], target_of(pooled, target)[valid], pooled.part[valid])


class _Rows(NamedTuple):
    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]


def probe_rows(train: Pooled, test: Pooled, worlds: str) -> list[dict[str, Any]]:
    """R² of all probes on the valid cells of all feature sets."""
    rows: list[dict[str, Any]] = []
    for number, feature_set in enumerate(FEATURE_SETS):
        chosen: Bool[np.ndarray, " M"] = test.cells.valid[number]
        if chosen.sum() < FEWEST:
            continue
        drawn = Sampling().on(_Rows(test.drive[chosen], test.cells.row[chosen]))
        for target, trained, name in product(TARGETS, TRAINED, INPUTS):
            ridge = fit_probe(train, target, name, feature_set if trained == "same" else trained)
            if ridge is not None:
                predicted = ridge.predict(INPUTS[name](test.cells, number)[chosen])
                found, interval = r2(target_of(test, target)[chosen], predicted, drawn)
                about: dict[str, object] = {"worlds": worlds, "target": target, "trained": trained, "input": name}
                about |= {"feature_set": feature_set, "penalty": ridge.penalty, "n": int(chosen.sum())}
                rows.append({**about, "r2": found, "r2_ci95": interval})
    return rows
