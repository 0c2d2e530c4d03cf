"""Several runs of one model as one result: averaged over seeds, put side by side over folds.

From errors, window by window, to the rows of metrics.json.

The result as a table on the terminal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Int
from rich.table import Table

from offpiste.dynamics.models import is_baseline
from offpiste.evaluation.errors import COMPONENTS, HORIZONS, Errors
from offpiste.evaluation.intervals import Resampling, blocks, paired, relative, resampling, summary
from offpiste.evaluation.results import Headline, Minus, ResultRow, label, pooled_rows, reading


def pool(runs: Sequence[Errors]) -> Errors:
    """Each window's error is the mean over the runs that judged it; windows in ascending order.

    Seeds judge the same windows, so their errors are averaged window by window; folds judge disjoint ones, so theirs
    are put together. What is averaged are errors, never predictions: an ensemble would be another model. A window in
    which one of the runs failed has failed.
    """
    keys, place = np.unique(np.concatenate([run.key for run in runs]), return_inverse=True)
    count = np.bincount(place).astype(float)
    values = np.zeros((len(keys), *runs[0].values.shape[1:]))
    loss = np.zeros(len(keys))
    np.add.at(values, place, np.concatenate([run.values for run in runs]))
    np.add.at(loss, place, np.concatenate([run.loss for run in runs]))
    return Errors(keys >> 32, keys & 0xFFFFFFFF, values / count[:, None, None], loss / count)


def positions(windows: Errors, among: Errors) -> Int[np.ndarray, " n"]:
    """Where each of the windows stands in `among`, which has them all in ascending order."""
    found = np.searchsorted(among.key, windows.key)
    assert np.array_equal(among.key[np.minimum(found, len(among.key) - 1)], windows.key), "not the same windows"
    return np.asarray(found)


REFERENCE = "kinematic"
"""The model that headlines compare with."""

Start = Literal["causal", "smoothed"]
Lookup = Literal["recorded", "map"]


class Case(NamedTuple):
    """A model judged in one way."""

    model: str
    variant: str
    start: Start
    lookup: Lookup | None
    feature_set: str | None = None

    @property
    def label(self) -> str:
        """The model's name, and its variant if it has one."""
        return label(self.model, self.variant)

    @property
    def reading(self) -> str:
        """Model, and where it reads the ground."""
        return reading(self.label, self.lookup, self.feature_set)


@dataclass(frozen=True)
class RunErrors:
    """Errors of one run of a model."""

    seed: int | None
    fold: int | None
    errors: Errors


Cases = Mapping[Case, list[RunErrors]]


@dataclass(frozen=True)
class Sampling:
    """How intervals are found: blocks of `block_seconds`, drawn from a seeded generator."""

    seed: int = 0
    block_seconds: float = 10.0

    def on(self, errors: Errors) -> Resampling:
        """Blocks of these windows. The same windows always get the same draws."""
        block = blocks(errors.drive, errors.row, seconds=self.block_seconds)
        return resampling(block, np.random.default_rng(self.seed))


def pooled(cases: Cases) -> dict[Case, Errors]:
    """Each case over all its runs."""
    return {case: pool([run.errors for run in runs]) for case, runs in cases.items()}


def result_rows(cases: Cases, part: str, sampling: Sampling) -> list[ResultRow]:
    """A row for every case and horizon; where a case has several runs, one over all of them and one for each.

    `minus` of a single run compares with the other models over all their runs, on that run's windows.
    """
    together = pooled(cases)
    rows = []
    for case, runs in cases.items():
        over_all = [RunErrors(None, None, together[case])] if len(runs) > 1 else []
        for run in over_all + runs:
            rows += _rows(case, run, together, part, sampling)
    return rows


def headlines(cases: Cases, sampling: Sampling) -> list[Headline]:
    """Each model but the baselines against `kinematic`, at 5 s."""
    together = pooled(cases)
    found = []
    for case, errors in together.items():
        reference = _counterpart(together, REFERENCE, case)
        if is_baseline(case.model) or reference is None:
            continue
        ratio = relative(errors.distance(), reference.distance(), sampling.on(errors))
        found.append(
            Headline(
                model=case.label,
                start=case.start,
                lookup=case.lookup,
                feature_set=case.feature_set,
                runs=len(cases[case]),
                distance_error_m=float(errors.distance().mean()),
                other=REFERENCE,
                relative=ratio.mean,
                ci95=ratio.ci95,
            )
        )
    return found


def _rows(
    case: Case, run: RunErrors, together: Mapping[Case, Errors], part: str, sampling: Sampling
) -> list[ResultRow]:
    errors = pool([run.errors])  # in ascending order
    drawn = sampling.on(errors)
    loss = summary(errors.loss, drawn)
    others = {}
    for other in dict.fromkeys(key.label for key in together):
        counterpart = _counterpart(together, other, case)
        if other != case.label and counterpart is not None:
            others[other] = counterpart.take(positions(errors, counterpart))
    loss_minus = {other: paired(errors.loss, found.loss, drawn) for other, found in others.items()}
    return [
        ResultRow(
            model=case.model,
            variant=case.variant,
            seed=run.seed,
            fold=run.fold,
            start=case.start,
            feature_set=case.feature_set,
            lookup=case.lookup,
            part=part,
            horizon_s=float(seconds),
            n=len(errors.row),
            n_failed=int(errors.failed[:, h].sum()),
            **{name: summary(errors.values[:, h, c], drawn) for c, name in enumerate(COMPONENTS)},
            loss=loss,
            minus={
                other: Minus(paired(errors.values[:, h, 0], found.values[:, h, 0], drawn), loss_minus[other])
                for other, found in others.items()
            },
        )
        for h, seconds in enumerate(HORIZONS)
    ]


def _counterpart(together: Mapping[Case, Errors], other: str, case: Case) -> Errors | None:
    """Another model judged in the same way, or in the only way it can be."""
    readings = ((case.lookup, case.feature_set), (None, None))
    for key, errors in together.items():
        if key.label == other and key.start == case.start and (key.lookup, key.feature_set) in readings:
            return errors
    # A baseline that does not read the ground, against one that does: as the latter decides, on the map.
    for lookup in ("map", "recorded"):
        for key, errors in together.items():
            if key.label == other and key.start == case.start and key.lookup == lookup and case.lookup is None:
                return errors
    return None


def number(value: float, digits: int = 2) -> str:
    """A number, or a dash where it is not finite."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def interval(bounds: tuple[float, float], digits: int = 2) -> str:
    """An interval, or a dash where there is none."""
    low, high = bounds
    return f"[{number(low, digits)}, {number(high, digits)}]" if np.isfinite(low) and np.isfinite(high) else "–"


def by_reading(rows: Sequence[ResultRow]) -> list[list[ResultRow]]:
    """Rows that differ only in the horizon, together, in ascending order of it."""
    found: dict[tuple[object, ...], list[ResultRow]] = {}
    for row in rows:
        key = (row.model, row.variant, row.seed, row.fold, row.start, row.feature_set, row.lookup)
        found.setdefault(key, []).append(row)
    return [sorted(group, key=lambda row: row.horizon_s) for group in found.values()]


def render_table(rows: Sequence[ResultRow]) -> Table:
    """Mean distance error by horizon, and the difference to `kinematic`; one line a model, start and lookup."""
    pooled = pooled_rows(list(rows))
    last_of = [group[-1] for group in by_reading(pooled)]
    windows = ", ".join(str(n) for n in sorted({row.n for row in last_of}))
    table = Table(
        title=rf"Mean distance error \[m] on {windows} windows of the {rows[0].part} part, 95 % intervals by blocks",
        title_justify="left",
    )
    for name in ("model", "start", "lookup"):
        table.add_column(name, no_wrap=True)
    for seconds in HORIZONS:
        table.add_column(f"{seconds} s", justify="right", no_wrap=True)
    table.add_column("at 5 s", no_wrap=True)
    table.add_column(f"minus {REFERENCE}", justify="right", no_wrap=True)
    for group in by_reading(pooled):
        last = group[-1]
        error = last.distance_error_m
        against = last.minus.get(REFERENCE)
        difference = against.distance_error_m if against else None
        table.add_row(
            last.label + (f" ({last.n_failed} failed)" if last.n_failed else ""),
            last.start,
            " ".join(filter(None, (last.lookup, last.feature_set))),
            *(number(row.distance_error_m.mean) for row in group),
            interval(error.ci95),
            f"{number(difference.mean)} {interval(difference.ci95)}" if difference else "",
        )
    return table
