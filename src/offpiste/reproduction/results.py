"""Numbers of a figure: errors with intervals, and the differences of each model to `b` on the same windows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool

from offpiste.core.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.feature_sets import set_number
from offpiste.dataset.store import Dataset
from offpiste.evaluation.errors import HORIZONS, Errors, SeededErrors, by_seed, load_errors, pool
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.intervals import Levels, PairedDifference, Sampling, relative
from offpiste.evaluation.metrics import Case, LossUnits, Provenance, ResultRow, RunErrors, result_rows
from offpiste.reproduction.runs import PART, errors_path
from offpiste.reproduction.settings import BASELINE, FigureModel, ReproductionSettings

SCHEMA = 2
QUANTITIES = ("distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "loss")
"""Errors that are compared with the baseline's, at the last horizon; the loss is over all steps."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """A model's mean errors relative to `b`'s, read in the same way on the same windows: -0.1 is 10 % below.

    Attributes:
        seed: of a single run, compared with the `b` of its seed; None over all.
        seen: whether only windows count in which all wheels have features of the set all along.
        n: number of windows.
        levels: numbers of drives, blocks and seeds that intervals are drawn from; None without windows.
    """

    model: str
    variant: str
    seed: int | None
    lookup: str
    feature_set: str | None
    seen: bool
    n: int
    levels: Levels | None
    relative: dict[str, PairedDifference]


class FigureMetrics(msgspec.Struct, frozen=True, kw_only=True):
    """Everything in the metrics.json of a figure."""

    schema: int = SCHEMA
    figure: str
    settings: dict[str, Any]
    dataset: str
    split: str
    part: str
    seeds: dict[str, list[int]]
    windows: dict[str, int]
    made: Provenance
    loss: LossUnits
    against_b: list[Comparison]
    coverage: dict[str, Any]
    results: list[ResultRow]


@dataclass(frozen=True)
class FigureResults:
    """Errors of all runs of a figure.

    Attributes:
        runs: by model and terrain lookup, one run per seed.
        sampling: settings of the intervals.
    """

    runs: Mapping[tuple[FigureModel, Reading], Sequence[RunErrors]]
    sampling: Sampling

    @property
    def readings(self) -> list[Reading]:
        """Terrain lookups, with their feature sets."""
        return list(dict.fromkeys(reading for _, reading in self.runs))

    @property
    def models(self) -> list[FigureModel]:
        """The models."""
        return list(dict.fromkeys(model for model, _ in self.runs))

    @property
    def baseline(self) -> FigureModel:
        """The model that the others are compared with."""
        return next(model for model in self.models if model.label == BASELINE)

    def over_seeds(self, model: FigureModel, reading: Reading) -> Errors:
        """Errors of a model, each window's the mean over its seeds."""
        return self.by_seed(model, reading).mean

    def by_seed(self, model: FigureModel, reading: Reading) -> SeededErrors:
        """Errors of a model's runs."""
        runs = self.runs[model, reading]
        return by_seed([run.errors for run in runs], [run.seed for run in runs])

    def levels(self, reading: Reading) -> Levels:
        """Numbers of drives, blocks and seeds of the baseline's runs."""
        errors = self.by_seed(self.baseline, reading)
        return self.sampling.on(errors).levels(len(errors.runs))

    def rows(self) -> list[ResultRow]:
        """The rows of metrics.json."""
        return result_rows(
            {_case(model, reading): list(runs) for (model, reading), runs in self.runs.items()}, PART, self.sampling
        )

    def compare(self, model: FigureModel, reading: Reading, seen: Bool[np.ndarray, " n"] | None = None) -> Comparison:
        """Comparison of a model with `b`, over all seeds.

        Args:
            seen: whether each window counts; None: all do.
        """
        mine, others = self.by_seed(model, reading), self.by_seed(self.baseline, reading)
        return self._compared(model, reading, mine, others, None, seen)

    def apart(self, first: FigureModel, second: FigureModel, readings: Sequence[Reading]) -> PairedDifference:
        """Mean distance error of one model minus another's, relative to `b`'s; over lookups of the same windows."""
        drawn = self.sampling.on(self.by_seed(self.baseline, readings[0]))
        mean, resampled = 0.0, np.zeros(len(drawn.draws))
        for reading in readings:
            one, other, b = (
                self.by_seed(model, reading).component("distance_error_m") for model in (first, second, self.baseline)
            )
            if not all(np.isfinite(errors).all() for errors in (one, other, b)):
                return PairedDifference(np.nan, (np.nan, np.nan))
            mean += float((one.mean() - other.mean()) / b.mean()) / len(readings)
            resampled += (drawn.means(one) - drawn.means(other)) / drawn.means(b) / len(readings)
        return PairedDifference(mean, drawn.interval(resampled))

    def compare_seeds(self, model: FigureModel, reading: Reading) -> list[Comparison]:
        """Comparison of each run of a model with the `b` of its seed."""
        mine, others = self.by_seed(model, reading), self.by_seed(self.baseline, reading)
        return [
            self._compared(model, reading, mine.of_seed(seed), others.of_seed(seed), seed, None)
            for seed in mine.seeds
            if seed in others.seeds
        ]

    def _compared(
        self,
        model: FigureModel,
        reading: Reading,
        mine: SeededErrors,
        others: SeededErrors,
        seed: int | None,
        seen: Bool[np.ndarray, " n"] | None,
    ) -> Comparison:
        index = np.arange(len(mine.row)) if seen is None else np.flatnonzero(seen)
        differences, levels = {name: PairedDifference(np.nan, (np.nan, np.nan)) for name in QUANTITIES}, None
        if len(index):
            mine, others = mine.take(index), others.take(index)
            drawn = self.sampling.on(mine)
            levels = drawn.levels(len(mine.runs))
            differences = {name: relative(mine.component(name), others.component(name), drawn) for name in QUANTITIES}
        lookup, chosen = reading
        return Comparison(
            model=model.model,
            variant=model.variant,
            seed=seed,
            lookup=str(lookup),
            feature_set=chosen,
            seen=seen is not None,
            n=len(index),
            levels=levels,
            relative=differences,
        )


def gather(settings: ReproductionSettings, models: Sequence[FigureModel], readings: Sequence[Reading]) -> FigureResults:
    """Read the errors of all runs."""
    runs = {
        (model, reading): [
            RunErrors(seed, None, pool([load_errors(errors_path(settings.runs / model.folder(seed), reading))]))
            for seed in range(settings.size.seeds)
        ]
        for model in models
        for reading in readings
    }
    return FigureResults(runs, Sampling())


def last_rows(rows: Sequence[ResultRow], *, single: bool = False) -> list[ResultRow]:
    """Rows at the last horizon: over all runs of a model, or those of single ones of several."""
    at_end = [row for row in rows if row.horizon_s == HORIZONS[-1]]
    several = {row.reading_label for row in at_end if row.seed is None}
    if single:
        return [row for row in at_end if row.seed is not None and row.reading_label in several]
    return [row for row in at_end if row.seed is None or row.reading_label not in several]


def _case(model: FigureModel, reading: Reading) -> Case:
    return Case(model.model, model.variant, "causal", *reading)


def seen_throughout(dataset: Dataset, feature_set: str, windows: Errors) -> Bool[np.ndarray, " n"]:
    """Whether each window's wheels are all on cells with features of the set, at rows t-10 ... t+249."""
    throughout = np.zeros(len(windows.row), bool)
    for number, drive in enumerate(dataset.drives):
        cells = drive.rows.cells
        mine = np.flatnonzero(windows.drive == number)
        if cells is None or not len(mine):
            continue
        valid = cells.valid[set_number(feature_set, len(cells.valid))]
        seen = ((cells.index >= 0) & valid[cells.index]).all(axis=1) if valid.size else np.zeros(len(cells.index), bool)
        run = np.concatenate(([0], np.cumsum(seen)))
        row = windows.row[mine]
        throughout[mine] = run[row + HORIZON_STEPS] - run[row - HISTORY_STEPS] == HORIZON_STEPS + HISTORY_STEPS
    return throughout
