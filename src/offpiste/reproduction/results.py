"""Errors of runs on the same windows, and the gains of models over a baseline, with intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
from jaxtyping import Bool

from offpiste.core.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.feature_sets import set_number
from offpiste.dataset.store import Dataset
from offpiste.evaluation.errors import (
    HORIZONS,
    Errors,
    SeededErrors,
    by_seed,
    load_errors,
    pool,
)
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.intervals import NO_INTERVAL, Levels, PairedDifference, Sampling, relative
from offpiste.evaluation.metrics import Case, LossUnits, Provenance, ResultRow, RunErrors, result_rows
from offpiste.report.text_table import interval
from offpiste.reproduction.runs import PART, errors_path
from offpiste.reproduction.settings import BASELINE, FigureModel, ReproductionSettings

SCHEMA: Final = 2
"""Version of a figure's metrics.json."""

MAP: Final[Reading] = ("map", None)
HINDSIGHT: Final[Reading] = ("recorded", "hindsight")

QUANTITIES: Final = ("distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "loss")
"""Errors that are compared with the baseline's, at the last horizon; the loss is over all steps."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """Mean errors of a model relative to those of `b`, with the same lookup on the same windows: -0.1 is 10 % less.

    Attributes:
        seed: of a single run, compared with the `b` of the same seed; None: all runs.
        seen: whether only windows with features under all wheels throughout are used.
        n: number of windows.
        levels: numbers of drives, blocks and seeds behind the intervals; None without windows.
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
    """Content of a figure's metrics.json."""

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
        runs: by model and terrain lookup, one per seed.
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
        """Models of the figure."""
        return list(dict.fromkeys(model for model, _ in self.runs))

    @property
    def baseline(self) -> FigureModel:
        """Model that the others are compared with."""
        return next(model for model in self.models if model.label == BASELINE)

    def over_seeds(self, model: FigureModel, reading: Reading) -> Errors:
        """Return the errors of a model, averaged over its seeds."""
        return self.by_seed(model, reading).mean

    def by_seed(self, model: FigureModel, reading: Reading) -> SeededErrors:
        """Return the errors of a model by seed."""
        runs = self.runs[model, reading]
        return by_seed([run.errors for run in runs], [run.seed for run in runs])

    def levels(self, reading: Reading) -> Levels:
        """Return the numbers of drives, blocks and seeds of the baseline."""
        errors = self.by_seed(self.baseline, reading)
        return self.sampling.on(errors).levels(len(errors.runs))

    def rows(self) -> list[ResultRow]:
        """Return the rows of metrics.json."""
        return result_rows(
            {_case(model, reading): list(runs) for (model, reading), runs in self.runs.items()}, PART, self.sampling
        )

    def compare(self, model: FigureModel, reading: Reading, seen: Bool[np.ndarray, " n"] | None = None) -> Comparison:
        """Compare a model with `b`, over all seeds.

        Args:
            seen: windows to use; None: all.
        """
        mine, others = self.by_seed(model, reading), self.by_seed(self.baseline, reading)
        return self._compared(model, reading, mine, others, None, seen)

    def apart(self, first: FigureModel, second: FigureModel, readings: Sequence[Reading]) -> PairedDifference:
        """Return the difference of two models' distance errors relative to that of `b`, averaged over lookups."""
        drawn = self.sampling.on(self.by_seed(self.baseline, readings[0]))
        mean, resampled = 0.0, np.zeros(len(drawn.draws))
        for reading in readings:
            one, other, b = (
                self.by_seed(model, reading).component("distance_error_m") for model in (first, second, self.baseline)
            )
            if not all(np.isfinite(errors).all() for errors in (one, other, b)):
                return PairedDifference(np.nan, NO_INTERVAL)
            mean += float((one.mean() - other.mean()) / b.mean()) / len(readings)
            resampled += (drawn.means(one) - drawn.means(other)) / drawn.means(b) / len(readings)
        return PairedDifference(mean, drawn.interval(resampled))

    def compare_seeds(self, model: FigureModel, reading: Reading) -> list[Comparison]:
        """Compare each run of a model with the `b` of the same seed."""
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
        differences, levels = {name: PairedDifference(np.nan, NO_INTERVAL) for name in QUANTITIES}, None
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


def last_rows(rows: Sequence[ResultRow]) -> list[ResultRow]:
    """Return the rows at the last horizon, over all runs of a model."""
    at_end = [row for row in rows if row.horizon_s == HORIZONS[-1]]
    several = {row.reading_label for row in at_end if row.seed is None}
    return [row for row in at_end if row.seed is None or row.reading_label not in several]


def _case(model: FigureModel, reading: Reading) -> Case:
    return Case(model.model, model.variant, "causal", *reading)


def seen_throughout(dataset: Dataset, feature_set: str, windows: Errors) -> Bool[np.ndarray, " n"]:
    """Return whether all wheels of each window are on cells with features of the set, at rows t-10 ... t+249."""
    throughout = np.zeros(len(windows.row), bool)
    for place, drive in enumerate(dataset.drives):
        cells = drive.rows.cells
        mine = np.flatnonzero(windows.drive == place)
        if cells is None or not len(mine):
            continue
        valid = cells.valid[set_number(feature_set, len(cells.valid))]
        seen = ((cells.index >= 0) & valid[cells.index]).all(axis=1) if valid.size else np.zeros(len(cells.index), bool)
        run = np.concatenate(([0], np.cumsum(seen)))
        row = windows.row[mine]
        throughout[mine] = run[row + HORIZON_STEPS] - run[row - HISTORY_STEPS] == HORIZON_STEPS + HISTORY_STEPS
    return throughout


def percent(difference: PairedDifference) -> str:
    """Format a relative difference and its interval in percent."""
    if not np.isfinite(difference.mean):
        return "–"
    low, high = difference.ci95
    return f"{100 * difference.mean:+.1f} % {interval((100 * low, 100 * high), 1)}"
