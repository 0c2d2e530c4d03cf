"""Rows of metrics.json, from errors window by window: one per model, start, terrain lookup and horizon."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from offpiste.dynamics.models import is_baseline
from offpiste.evaluation.errors import COMPONENTS, HORIZONS, Errors, SeededErrors, by_seed, positions
from offpiste.evaluation.intervals import Sampling, paired, relative, summary
from offpiste.evaluation.metrics import Headline, Labelled, Minus, ResultRow
from offpiste.training.prediction import Lookup

REFERENCE = "kinematic"
"""The model that headlines compare with."""

Start = Literal["causal", "smoothed"]


@dataclass(frozen=True)
class Case(Labelled):
    """A model with the start of its predictions and the terrain that it reads."""

    model: str
    variant: str
    start: Start
    lookup: Lookup | None
    feature_set: str | None = None


@dataclass(frozen=True)
class RunErrors:
    """Errors of one run of a model."""

    seed: int | None
    fold: int | None
    errors: Errors


Cases = Mapping[Case, list[RunErrors]]


def seeded(cases: Cases) -> dict[Case, SeededErrors]:
    """Errors of each case by seed."""
    return {case: by_seed([run.errors for run in runs], [run.seed for run in runs]) for case, runs in cases.items()}


def result_rows(cases: Cases, part: str, sampling: Sampling) -> list[ResultRow]:
    """Rows of every case and horizon; where a case has several runs, one over all of them and one for each.

    `minus` of a single run compares with the other models' runs of its seed, or with all of theirs where there is
    none, on that run's windows.
    """
    together = seeded(cases)
    rows = []
    for case, runs in cases.items():
        if len(runs) > 1:
            rows += _rows(case, RunErrors(None, None, together[case].mean), together[case], together, part, sampling)
        for run in runs:
            rows += _rows(case, run, by_seed([run.errors], [run.seed]), together, part, sampling)
    return rows


def headlines(cases: Cases, sampling: Sampling) -> list[Headline]:
    """Comparison of each model but the baselines with `kinematic`, at 5 s."""
    together = seeded(cases)
    result = []
    for case, errors in together.items():
        reference = _counterpart(together, REFERENCE, case)
        if is_baseline(case.model) or reference is None:
            continue
        drawn = sampling.on(errors)
        ratio = relative(errors.distance(), reference.distance(), drawn)
        result.append(
            Headline(
                model=case.label,
                start=case.start,
                lookup=case.lookup,
                feature_set=case.feature_set,
                runs=len(cases[case]),
                levels=drawn.levels(len(errors.runs)),
                distance_error_m=float(errors.distance().mean()),
                other=REFERENCE,
                relative=ratio.mean,
                ci95=ratio.ci95,
            )
        )
    return result


def _rows(
    case: Case,
    run: RunErrors,
    errors: SeededErrors,
    together: Mapping[Case, SeededErrors],
    part: str,
    sampling: Sampling,
) -> list[ResultRow]:
    """Rows of a run, or of all runs of a case (`errors`, by seed)."""
    drawn = sampling.on(errors)
    loss = summary(errors.loss, drawn)
    others: dict[str, SeededErrors] = {}
    for other in dict.fromkeys(key.label for key in together):
        counterpart = _counterpart(together, other, case)
        if other != case.label and counterpart is not None:
            others[other] = counterpart.take(positions(errors, counterpart)).of_seed(run.seed)
    loss_minus = {other: paired(errors.loss, result.loss, drawn) for other, result in others.items()}
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
            n_failed=int(run.errors.failed[:, h].sum()),
            levels=drawn.levels(len(errors.runs)),
            **{name: summary(errors.at(h, c), drawn) for c, name in enumerate(COMPONENTS)},
            loss=loss,
            minus={
                other: Minus(paired(errors.at(h, 0), result.at(h, 0), drawn), loss_minus[other])
                for other, result in others.items()
            },
        )
        for h, seconds in enumerate(HORIZONS)
    ]


def _counterpart(together: Mapping[Case, SeededErrors], other: str, case: Case) -> SeededErrors | None:
    """Errors of another model that reads the terrain in the same way, or in the only way it can."""
    readings = ((case.lookup, case.feature_set), (None, None))
    for key, errors in together.items():
        if key.label == other and key.start == case.start and (key.lookup, key.feature_set) in readings:
            return errors
    # A baseline that does not read the terrain is compared on the map, which decides.
    for lookup in ("map", "recorded"):
        for key, errors in together.items():
            if key.label == other and key.start == case.start and key.lookup == lookup and case.lookup is None:
                return errors
    return None


def by_reading(rows: Sequence[ResultRow]) -> list[list[ResultRow]]:
    """Groups of rows that differ only in the horizon, in ascending order of it."""
    result: dict[tuple[object, ...], list[ResultRow]] = {}
    for row in rows:
        key = (row.model, row.variant, row.seed, row.fold, row.start, row.feature_set, row.lookup)
        result.setdefault(key, []).append(row)
    return [sorted(group, key=lambda row: row.horizon_s) for group in result.values()]
