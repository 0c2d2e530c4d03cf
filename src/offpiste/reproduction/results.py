"""The numbers of a figure: errors with intervals, and what each model gains over `b` on the same windows.

Windows whose ground was seen all along: on them, what grows with distance is not for want of features.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool

from offpiste.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.feature_sets import set_number
from offpiste.dataset.store import Dataset
from offpiste.evaluation.error_files import load_errors
from offpiste.evaluation.errors import HORIZONS, Errors, pool
from offpiste.evaluation.evaluated_models import Reading
from offpiste.evaluation.intervals import PairedDifference, Sampling, relative
from offpiste.evaluation.metrics import LossUnits, Provenance, ResultRow
from offpiste.evaluation.result_rows import Case, RunErrors, result_rows
from offpiste.reproduction.runs import PART, errors_path
from offpiste.reproduction.settings import BASELINE, Member, Reproduction

SCHEMA = 1
QUANTITIES = ("distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "loss")
"""That are compared with the baseline's, at the last horizon; the loss is over all steps."""


class Against(msgspec.Struct, frozen=True, kw_only=True):
    """A model's mean errors relative to `b`'s, read in the same way on the same windows: -0.1 is 10 % below.

    Attributes:
        seed: of a single run, against the `b` of its seed; None over all.
        seen: only windows whose ground has features of the set all along.
        n: windows.
    """

    model: str
    variant: str
    seed: int | None
    lookup: str
    feature_set: str | None
    seen: bool
    n: int
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
    against_b: list[Against]
    coverage: dict[str, Any]
    results: list[ResultRow]


@dataclass(frozen=True)
class Findings:
    """Errors of all runs of a figure.

    Attributes:
        runs: by model and way of reading the ground, a run a seed.
        sampling: of the intervals.
    """

    runs: Mapping[tuple[Member, Reading], Sequence[RunErrors]]
    sampling: Sampling

    @property
    def readings(self) -> list[Reading]:
        """Ways of reading the ground."""
        return list(dict.fromkeys(reading for _, reading in self.runs))

    @property
    def members(self) -> list[Member]:
        """The models."""
        return list(dict.fromkeys(member for member, _ in self.runs))

    @property
    def baseline(self) -> Member:
        """The model that the others are compared with."""
        return next(member for member in self.members if member.label == BASELINE)

    def over_seeds(self, member: Member, reading: Reading) -> Errors:
        """Errors of a model, each window's the mean over its seeds."""
        return pool([run.errors for run in self.runs[member, reading]])

    def rows(self) -> list[ResultRow]:
        """The rows of metrics.json."""
        return result_rows(
            {_case(member, reading): list(runs) for (member, reading), runs in self.runs.items()}, PART, self.sampling
        )

    def against(self, member: Member, reading: Reading, seen: Bool[np.ndarray, " n"] | None = None) -> Against:
        """A model against `b`, over all seeds.

        Args:
            seen: windows that count.
        """
        mine, others = self.over_seeds(member, reading), self.over_seeds(self.baseline, reading)
        return self._compared(member, reading, mine, others, None, seen)

    def each_seed(self, member: Member, reading: Reading) -> list[Against]:
        """Each run of a model against the `b` of its seed."""
        others = {run.seed: run.errors for run in self.runs[self.baseline, reading]}
        return [
            self._compared(member, reading, run.errors, others[run.seed], run.seed, None)
            for run in self.runs[member, reading]
            if run.seed in others
        ]

    def _compared(
        self,
        member: Member,
        reading: Reading,
        mine: Errors,
        others: Errors,
        seed: int | None,
        seen: Bool[np.ndarray, " n"] | None,
    ) -> Against:
        index = np.arange(len(mine.row)) if seen is None else np.flatnonzero(seen)
        found = {name: PairedDifference(np.nan, (np.nan, np.nan)) for name in QUANTITIES}
        if len(index):
            mine, others = mine.take(index), others.take(index)
            drawn = self.sampling.on(mine)
            found = {name: relative(mine.component(name), others.component(name), drawn) for name in QUANTITIES}
        lookup, chosen = reading
        return Against(
            model=member.model,
            variant=member.variant,
            seed=seed,
            lookup=str(lookup),
            feature_set=chosen,
            seen=seen is not None,
            n=len(index),
            relative=found,
        )


def gather(asked: Reproduction, members: Sequence[Member], readings: Sequence[Reading]) -> Findings:
    """Read the errors of all runs."""
    runs = {
        (member, reading): [
            RunErrors(seed, None, pool([load_errors(errors_path(asked.runs / member.folder(seed), reading))]))
            for seed in member.seeds(asked.size)
        ]
        for member in members
        for reading in readings
    }
    return Findings(runs, Sampling())


def last_rows(rows: Sequence[ResultRow], *, single: bool = False) -> list[ResultRow]:
    """Rows at the last horizon: over all runs of a model, or those of single ones of several."""
    at_end = [row for row in rows if row.horizon_s == HORIZONS[-1]]
    several = {row.reading_label for row in at_end if row.seed is None}
    if single:
        return [row for row in at_end if row.seed is not None and row.reading_label in several]
    return [row for row in at_end if row.seed is None or row.reading_label not in several]


def _case(member: Member, reading: Reading) -> Case:
    return Case(member.model, member.variant, "causal", *reading)


def valid_throughout(dataset: Dataset, feature_set: str, windows: Errors) -> Bool[np.ndarray, " n"]:
    """Whether every wheel stands on a cell with features of the set at rows t-10 ... t+249 of each window."""
    found = np.zeros(len(windows.row), bool)
    for number, drive in enumerate(dataset.drives):
        cells = drive.rows.cells
        mine = np.flatnonzero(windows.drive == number)
        if cells is None or not len(mine):
            continue
        valid = cells.valid[set_number(feature_set, len(cells.valid))]
        seen = ((cells.index >= 0) & valid[cells.index]).all(axis=1) if valid.size else np.zeros(len(cells.index), bool)
        run = np.concatenate(([0], np.cumsum(seen)))
        row = windows.row[mine]
        found[mine] = run[row + HORIZON_STEPS] - run[row - HISTORY_STEPS] == HORIZON_STEPS + HISTORY_STEPS
    return found
