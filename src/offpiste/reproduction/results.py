"""Errors of a figure's runs on the same windows, and their comparison with the baseline."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
from jaxtyping import Bool

from offpiste.core.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.feature_sets import set_number
from offpiste.dataset.store import Dataset
from offpiste.evaluation.errors import Errors, SeededErrors, by_seed, load_errors, pool
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
"""Errors compared with the baseline's: at the last horizon, and the loss over all steps."""


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
    """Errors of all runs of a figure, by model and terrain lookup."""

    runs: Mapping[tuple[FigureModel, Reading], Sequence[RunErrors]]
    sampling: Sampling

    @property
    def readings(self) -> list[Reading]:
        """Terrain lookups, with their feature sets."""
        return list(dict.fromkeys(reading for _, reading in self.runs))

    @property
    def models(self) -> dict[str, FigureModel]:
        """Models of the figure, by label."""
        return {model.label: model for model, _ in self.runs}

    @property
    def baseline(self) -> FigureModel:
        """Model that the others are compared with."""
        return self.models[BASELINE]

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
        cases = {Case(m.model, m.variant, "causal", *reading): list(runs) for (m, reading), runs in self.runs.items()}
        return result_rows(cases, PART, self.sampling)

    def apart(self, first: str, second: str, readings: Sequence[Reading]) -> PairedDifference:
        """Return the difference of two models' distance errors relative to that of `b`, averaged over lookups."""
        drawn = self.sampling.on(self.by_seed(self.baseline, readings[0]))
        mean, resampled = 0.0, np.zeros(len(drawn.draws))
        for reading in readings:
            one, other, b = (
                self.by_seed(self.models[label], reading).distance() for label in (first, second, BASELINE)
            )
            if not all(np.isfinite(errors).all() for errors in (one, other, b)):
                return PairedDifference(np.nan, NO_INTERVAL)
            mean += float((one.mean() - other.mean()) / b.mean()) / len(readings)
            resampled += (drawn.means(one) - drawn.means(other)) / drawn.means(b) / len(readings)
        return PairedDifference(mean, drawn.interval(resampled))

    def compare(
        self,
        model: FigureModel,
        reading: Reading,
        seen: Bool[np.ndarray, " n"] | None = None,
        *,
        seed: int | None = None,
    ) -> Comparison:
        """Compare a model with `b`.

        Args:
            seen: windows to use; None: all.
            seed: of the runs to compare; None: all runs.
        """
        mine, others = (self.by_seed(each, reading).of_seed(seed) for each in (model, self.baseline))
        index = np.arange(len(mine.row)) if seen is None else np.flatnonzero(seen)
        differences, levels = {name: PairedDifference(np.nan, NO_INTERVAL) for name in QUANTITIES}, None
        if len(index):
            mine, others = mine.take(index), others.take(index)
            drawn = self.sampling.on(mine)
            levels = drawn.levels(len(mine.runs))
            differences = {name: relative(mine.component(name), others.component(name), drawn) for name in QUANTITIES}
        return Comparison(
            model=model.model,
            variant=model.variant,
            seed=seed,
            lookup=str(reading[0]),
            feature_set=reading[1],
            seen=seen is not None,
            n=len(index),
            levels=levels,
            relative=differences,
        )

    def compare_seeds(self, model: FigureModel, reading: Reading) -> list[Comparison]:
        """Compare each run of a model with the `b` of the same seed."""
        seeds, others = (self.by_seed(each, reading).seeds for each in (model, self.baseline))
        return [self.compare(model, reading, seed=seed) for seed in seeds if seed in others]


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


def seen_throughout(dataset: Dataset, feature_set: str, windows: Errors) -> Bool[np.ndarray, " n"]:
    """Return a mask of windows with all wheels on cells with features of the set, at rows t-10 ... t+249."""
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
