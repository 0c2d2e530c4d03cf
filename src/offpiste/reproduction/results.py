"""Errors of a figure's runs on the same windows, and their comparison with the baseline."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np

from offpiste.evaluation.errors import SeededErrors, by_seed, load_errors, pool
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.intervals import NO_INTERVAL, Levels, PairedDifference, Sampling, relative
from offpiste.evaluation.metrics import Case, LossUnits, Provenance, ResultRow, RunErrors, result_rows
from offpiste.reproduction.runs import PART, errors_path
from offpiste.reproduction.settings import BASELINE, FigureModel, ReproductionSettings

SCHEMA: Final = 3
"""Version of a figure's metrics.json."""

MAP: Final[Reading] = ("map", None)
HINDSIGHT: Final[Reading] = ("recorded", "hindsight")

QUANTITIES: Final = ("distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "loss")
"""Errors compared with the baseline's: at the last horizon, and the loss over all steps."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """Mean errors of a model relative to those of `b`, with the same lookup on the same windows: -0.1 is 10 % less.

    Attributes:
        seed: of a single run, compared with the `b` of the same seed; None: all runs.
        n: number of windows.
        levels: numbers of drives, blocks and seeds behind the intervals.
    """

    model: str
    variant: str
    seed: int | None
    lookup: str
    feature_set: str | None
    n: int
    levels: Levels
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

    def errors(self, label: str, reading: Reading) -> SeededErrors:
        """Return the errors of a model by seed."""
        runs = self.runs[self.models[label], reading]
        return by_seed([run.errors for run in runs], [run.seed for run in runs])

    def levels(self, reading: Reading) -> Levels:
        """Return the numbers of drives, blocks and seeds of the baseline."""
        errors = self.errors(BASELINE, reading)
        return self.sampling.on(errors).levels(len(errors.seeds))

    def rows(self) -> list[ResultRow]:
        """Return the rows of metrics.json."""
        cases = {Case(m.model, m.variant, "causal", *reading): list(runs) for (m, reading), runs in self.runs.items()}
        return result_rows(cases, PART, self.sampling)

    def apart(self, first: str, second: str, readings: Sequence[Reading]) -> PairedDifference:
        """Return the difference of two models' distance errors relative to that of `b`, averaged over lookups."""
        drawn = self.sampling.on(self.errors(BASELINE, readings[0]))
        mean, resampled = 0.0, np.zeros(len(drawn.draws))
        for reading in readings:
            one, other, b = (self.errors(label, reading).distance() for label in (first, second, BASELINE))
            if not all(np.isfinite(errors).all() for errors in (one, other, b)):
                return PairedDifference(np.nan, NO_INTERVAL)
            mean += float((one.mean() - other.mean()) / b.mean()) / len(readings)
            resampled += (drawn.means(one) - drawn.means(other)) / drawn.means(b) / len(readings)
        return PairedDifference(mean, drawn.interval(resampled))

    def compare(self, label: str, reading: Reading, *, seed: int | None = None) -> Comparison:
        """Compare a model with `b`: all runs, or those of a seed."""
        mine, others = (self.errors(each, reading).of_seed(seed) for each in (label, BASELINE))
        drawn, model = self.sampling.on(mine), self.models[label]
        return Comparison(
            model=model.model,
            variant=model.variant,
            seed=seed,
            lookup=str(reading[0]),
            feature_set=reading[1],
            n=len(mine.row),
            levels=drawn.levels(len(mine.seeds)),
            relative={name: relative(mine.component(name), others.component(name), drawn) for name in QUANTITIES},
        )

    def compare_seeds(self, label: str, reading: Reading) -> list[Comparison]:
        """Compare each run of a model with the `b` of the same seed; empty for a single run."""
        seeds, others = (self.errors(each, reading).seeds for each in (label, BASELINE))
        return [self.compare(label, reading, seed=seed) for seed in seeds if seed in others and len(seeds) > 1]


def read_results(
    settings: ReproductionSettings, models: Sequence[FigureModel], readings: Sequence[Reading]
) -> FigureResults:
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
