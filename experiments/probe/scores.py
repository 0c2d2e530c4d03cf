"""Probes fitted on the cells of some drives and tested on those of others, by feature set."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from experiments.probe.cells import SeenCells
from experiments.probe.ridge import Ridge, Score, fit_ridge, score
from offpiste.core.conventions import FEATURE_SETS
from offpiste.evaluation.intervals import Resampling, Sampling
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES

TARGETS = ("friction", "rolling_resistance")

COMMON = ("hindsight", "-10", "0", "10", "20")
"""Feature sets that are also tested on the cells valid in all of them."""

PARTS = 5
"""Parts of the cross-validation that chooses the penalty: fifths of every drive, in the order of time."""

FEWEST = 50
"""Least number of cells to fit or test on."""

NEARBY = 20
"""Rows to either side over which features are averaged along the path: 0.4 s, 2 m at 5 m/s."""

TRAINED = ("hindsight", "all", "same")
"""Feature sets that a probe sees in training: hindsight only, all of them, or the one it is tested on."""


@dataclass(frozen=True)
class Pooled:
    """Cells of several drives.

    Attributes:
        cells: drive after drive.
        drive: number of each cell's drive.
        world: number of the world that the drive is in.
    """

    cells: SeenCells
    drive: Int[np.ndarray, " M"]
    world: Int[np.ndarray, " M"]

    @property
    def part(self) -> Int[np.ndarray, " M"]:
        """Which of `PARTS` each belongs to."""
        part = np.zeros(len(self.drive), np.int64)
        for number in np.unique(self.drive):
            mine = self.drive == number
            row = self.cells.row[mine]
            part[mine] = np.clip((row - row.min()) * PARTS // (np.ptp(row) + 1), 0, PARTS - 1)
        return part


def pool(drives: Sequence[tuple[int, SeenCells]]) -> Pooled:
    """Put drives together, each with the number of its world."""
    cells = [c for _, c in drives]
    counts = [len(c.row) for c in cells]
    return Pooled(
        cells=SeenCells(
            features=np.concatenate([c.features for c in cells], axis=1),
            colour=np.concatenate([c.colour for c in cells], axis=1),
            valid=np.concatenate([c.valid for c in cells], axis=1),
            properties=np.concatenate([c.properties for c in cells]),
            ground=np.concatenate([c.ground for c in cells]),
            row=np.concatenate([c.row for c in cells]),
        ),
        drive=np.repeat(np.arange(len(cells)), counts),
        world=np.repeat([world for world, _ in drives], counts),
    )


Input = Callable[[Pooled, int], Float[np.ndarray, "M F"]]
"""What a probe reads of all cells in the set of this number."""


def _kind(pooled: Pooled, number: int) -> Float[np.ndarray, "M F"]:
    shares = pooled.cells.ground[:, : len(GROUND_KINDS)]
    return np.eye(len(GROUND_KINDS))[shares.argmax(axis=1)]


def _averaged(pooled: Pooled, number: int) -> Float[np.ndarray, "M F"]:
    """Visual features, each the mean over valid cells that the drive enters at most `NEARBY` rows before or after."""
    cells, result = pooled.cells, np.full(pooled.cells.features[number].shape, np.nan)
    for drive in np.unique(pooled.drive):
        mine = np.flatnonzero((pooled.drive == drive) & cells.valid[number])
        mine = mine[np.argsort(cells.row[mine], kind="stable")]
        row, features = cells.row[mine], cells.features[number, mine].astype(np.float64)
        sums = np.concatenate((np.zeros((1, features.shape[1])), features.cumsum(axis=0)))
        first, stop = np.searchsorted(row, row - NEARBY), np.searchsorted(row, row + NEARBY, side="right")
        result[mine] = (sums[stop] - sums[first]) / (stop - first)[:, None]
    return result


INPUTS: Mapping[str, Input] = {
    "visual": lambda pooled, number: pooled.cells.features[number],
    "averaged": _averaged,
    "colour": lambda pooled, number: pooled.cells.colour[number],
    "brightness": lambda pooled, number: pooled.cells.colour[number].mean(axis=1, keepdims=True),
    "world": lambda pooled, number: np.eye(1 + pooled.world.max())[pooled.world],
    "kind": _kind,
    "ground": lambda pooled, number: pooled.cells.ground,
}
"""`visual` components of the backbone; `averaged` the same along the way, which shows how much of what is missed is
noise of single patches; `colour` and `brightness` (the floor) of the same patches; `world` which world
it is, nothing of the cell; `kind` the true ground kind, one of seven (the ceiling); `ground` true shares of kinds, and
wetness."""


def target_of(pooled: Pooled, target: str) -> Float[np.ndarray, " M"]:
    """A true property of the ground at each cell."""
    return pooled.cells.properties[:, GROUND_PROPERTIES.index(target)].astype(np.float64)


def fit_probe(pooled: Pooled, target: str, name: str, sets: Sequence[str]) -> Ridge | None:
    """A ridge from an input to a target on the valid cells of these sets; None where there are too few."""
    y, part = target_of(pooled, target), pooled.part
    rows, inputs = [], []
    for number in map(FEATURE_SETS.index, sets):
        valid = np.flatnonzero(pooled.cells.valid[number])
        rows.append(valid)
        inputs.append(INPUTS[name](pooled, number)[valid].astype(np.float64))
    chosen = np.concatenate(rows)
    if len(chosen) < FEWEST:
        return None
    return fit_ridge(np.concatenate(inputs), y[chosen], part[chosen])


def drawn_blocks(pooled: Pooled, chosen: Bool[np.ndarray, " M"], *, seed: int = 0) -> Resampling:
    """Resamples of drives, and of blocks of 10 s within each."""
    return Sampling(seed).on(_Rows(pooled.drive[chosen], pooled.cells.row[chosen]))


class _Rows(NamedTuple):
    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]


@dataclass(frozen=True)
class HeldOutCells:
    """Cells that are valid in a set, and the resamples of their blocks."""

    pooled: Pooled
    feature_set: str
    chosen: Bool[np.ndarray, " M"]
    drawn: Resampling


def held_out_cells(pooled: Pooled, feature_set: str, chosen: Bool[np.ndarray, " M"]) -> HeldOutCells | None:
    """Cells to test probes on; None where there are too few."""
    return HeldOutCells(pooled, feature_set, chosen, drawn_blocks(pooled, chosen)) if chosen.sum() >= FEWEST else None


def score_probe(ridge: Ridge, target: str, name: str, on: HeldOutCells) -> Score:
    """Score of a probe on a target."""
    predicted = ridge.predict(INPUTS[name](on.pooled, FEATURE_SETS.index(on.feature_set))[on.chosen])
    return score(target_of(on.pooled, target)[on.chosen], predicted, on.drawn)


def probe_rows(train: Pooled, test: Pooled, worlds: str) -> list[dict[str, Any]]:
    """Scores of all probes on all feature sets: on the cells valid there, and on those valid in all of `COMMON`."""
    valid = {name: test.cells.valid[number] for number, name in enumerate(FEATURE_SETS)}
    common = np.asarray(np.stack([valid[name] for name in COMMON]).all(axis=0))
    cells = {("valid", name): held_out_cells(test, name, chosen) for name, chosen in valid.items()}
    cells |= {("common", name): held_out_cells(test, name, common) for name in COMMON}
    rows: list[dict[str, Any]] = []
    for target, trained, name in product(TARGETS, TRAINED, INPUTS):
        training = _training_sets(trained)
        fits = {sets: fit_probe(train, target, name, sets) for sets in set(training.values())}
        for (which, feature_set), on in cells.items():
            ridge = fits[training[feature_set]]
            if ridge is None or on is None:
                continue
            about: dict[str, Any] = {"worlds": worlds, "target": target, "trained": trained, "input": name}
            about |= {"feature_set": feature_set, "cells": which, "penalty": ridge.penalty}
            rows.append(about | asdict(score_probe(ridge, target, name, on)))
    return rows


def _training_sets(trained: str) -> dict[str, tuple[str, ...]]:
    """Training sets by test set."""
    whole = {"hindsight": ("hindsight",), "all": FEATURE_SETS}
    return {name: whole.get(trained, (name,)) for name in FEATURE_SETS}
