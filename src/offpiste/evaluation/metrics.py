"""Results of an evaluation: rows and headlines of metrics.json (docs/formats.md)."""

import os
import platform
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Final, Literal

import msgspec
import numpy as np
import torch
from msgspec.structs import asdict

from offpiste.core.files import write_text
from offpiste.dynamics.models import display_name, is_baseline
from offpiste.evaluation.errors import ERROR_NAMES, HORIZONS, Errors, SeededErrors, by_seed, positions
from offpiste.evaluation.evaluated_windows import EvaluatedWindows, members
from offpiste.evaluation.intervals import Levels, PairedDifference, Sampling, Statistics, paired, relative, summary
from offpiste.training.prediction import Lookup

SCHEMA: Final = 2
"""Version of metrics.json."""

REFERENCE: Final = "kinematic"
"""Model that headlines compare with."""

Start = Literal["causal", "smoothed"]
"""Estimate of the state that predictions start from."""


class Minus(msgspec.Struct, frozen=True):
    """Paired differences to another model on the same windows; negative if this model is better."""

    distance_error_m: PairedDifference
    loss: PairedDifference


class Case(msgspec.Struct, frozen=True):
    """A model with the start of its predictions and its terrain lookup.

    Attributes:
        lookup: None for models that do not read the terrain.
        feature_set: read at recorded places, in datasets with features by distance; else None.
    """

    model: str
    variant: str
    start: Start
    lookup: Lookup | None
    feature_set: str | None = None

    @property
    def label(self) -> str:
        """Registered name of the model with its variant, which identifies it."""
        return label(self.model, self.variant)

    @property
    def reading_label(self) -> str:
        """Display name of the model with its terrain lookup."""
        return reading_label(self.label, self.lookup, self.feature_set)


@dataclass(frozen=True)
class RunErrors:
    """Errors of one run of a model."""

    seed: int | None
    fold: int | None
    errors: Errors


Cases = Mapping[Case, list[RunErrors]]


class ResultRow(Case, frozen=True, kw_only=True):
    """Results of one case and horizon.

    Attributes:
        seed, fold: of the run; both None for all runs of a model together (`offpiste.evaluation.errors.pool`).
        n: number of windows.
        n_failed: number of predictions that are not finite at this horizon; if any, the mean is infinite, null in JSON.
        levels: numbers of drives, blocks and seeds behind the intervals.
        loss: over all steps up to 5 s, at every horizon.
        minus: paired differences by label of the other model.
    """

    seed: int | None
    fold: int | None
    part: str
    horizon_s: float
    n: int
    n_failed: int
    levels: Levels
    distance_error_m: Statistics
    yaw_error_rad: Statistics
    vx_error_mps: Statistics
    vy_error_mps: Statistics
    yaw_rate_error_radps: Statistics
    loss: Statistics
    minus: dict[str, Minus]


class BandRow(Case, frozen=True, kw_only=True):
    """Distance errors of one case and horizon, in windows of one band of initial speeds.

    Attributes:
        band: name of the band (`offpiste.evaluation.evaluated_windows.members`).
        n: number of windows.
        levels: numbers of drives, blocks and seeds behind the intervals.
    """

    band: str
    horizon_s: float
    n: int
    distance_error_m: Statistics
    levels: Levels


class Headline(msgspec.Struct, frozen=True, kw_only=True):
    """Distance error of a model after 5 s, and its relative difference to that of `other`: -0.3 is 30 % less."""

    model: str
    start: str
    lookup: str | None
    feature_set: str | None = None
    runs: int
    levels: Levels
    distance_error_m: float
    other: str
    relative: float
    ci95: tuple[float, float]


class WindowNumbers(msgspec.Struct, frozen=True, kw_only=True):
    """Statistics of the evaluated windows.

    Attributes:
        n: number of windows.
        driven_in_training: share of the part's path within 5 m of the training path.
    """

    n: int
    drives: int
    stride_s: float
    blocks: int
    block_s: float
    median_distance_m: float
    median_speed_mps: float
    driven_in_training: float


class LossUnits(msgspec.Struct, frozen=True):
    """Weights of the loss's components, and the mean square errors that divide them."""

    weights: dict[str, float]
    scale: dict[str, float]


class Provenance(msgspec.Struct, frozen=True):
    """Date, command, machine, versions and seed of an evaluation."""

    date: str
    command: str
    machine: str
    versions: dict[str, str]
    seed: int

    def facts(self) -> dict[str, str]:
        """Return the text of each fact for a page."""
        versions = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        return {"date": self.date, "machine": self.machine, "command": self.command, "versions": versions}


class Metrics(msgspec.Struct, frozen=True, kw_only=True):
    """Content of metrics.json.

    Attributes:
        bands: results by initial speed.
        assumptions: of the dataset (`offpiste.dataset.assumptions`).
        features: whether the dataset has terrain features.
    """

    schema: int = SCHEMA
    dataset: str
    split: str
    part: str
    made: Provenance
    loss: LossUnits
    windows: WindowNumbers
    headlines: list[Headline]
    results: list[ResultRow]
    warnings: tuple[str, ...]
    assumptions: tuple[str, ...]
    features: bool
    bands: list[BandRow]


def label(model: str, variant: str) -> str:
    """Return the name of a model, with its variant if any."""
    return f"{model} ({variant})" if variant else model


def display(label: str) -> str:
    """Replace the registered name in a model's label by its display name: "blind (flat)" for "b (flat)"."""
    name, space, variant = label.partition(" ")
    return display_name(name) + space + variant


def reading_label(label: str, lookup: str | None, feature_set: str | None = None) -> str:
    """Return a model's display name with its terrain lookup, and the viewing distance unless that is hindsight."""
    distance = "" if feature_set in (None, "hindsight") else f" {feature_set} m"
    return f"{display(label)} · {lookup}{distance}" if lookup else display(label)


def seeded(cases: Cases) -> dict[Case, SeededErrors]:
    """Return the errors of each case by seed."""
    return {case: by_seed([run.errors for run in runs], [run.seed for run in runs]) for case, runs in cases.items()}


def result_rows(cases: Cases, part: str, sampling: Sampling) -> list[ResultRow]:
    """Return a row for every case, horizon and run; for a case with several runs, first a row over all runs.

    `minus` of a single run compares it with the other models' runs of the same seed, or with all their runs if there is
    none, on the windows of that run.
    """
    together = seeded(cases)
    rows = []
    for case, runs in cases.items():
        if len(runs) > 1:
            rows += _rows(case, RunErrors(None, None, together[case].mean), together[case], together, part, sampling)
        for run in runs:
            rows += _rows(case, run, by_seed([run.errors], [run.seed]), together, part, sampling)
    return rows


def _rows(
    case: Case,
    run: RunErrors,
    errors: SeededErrors,
    together: Mapping[Case, SeededErrors],
    part: str,
    sampling: Sampling,
) -> list[ResultRow]:
    """Return the rows of a run, or of all runs of a case (`errors`, by seed)."""
    drawn = sampling.on(errors)
    others: dict[str, SeededErrors] = {}
    for other in dict.fromkeys(key.label for key in together):
        counterpart = _counterpart(together, other, case)
        if other != case.label and counterpart is not None:
            others[other] = counterpart.take(positions(errors, counterpart)).of_seed(run.seed)

    def minus(other: SeededErrors, name: str, horizon: int = -1) -> PairedDifference:
        return paired(errors.component(name, horizon), other.component(name, horizon), drawn)

    loss = summary(errors.loss, drawn)
    loss_minus = {label: minus(other, "loss") for label, other in others.items()}
    return [
        ResultRow(
            **asdict(case) | {name: summary(errors.component(name, h), drawn) for name in ERROR_NAMES},
            seed=run.seed,
            fold=run.fold,
            part=part,
            horizon_s=float(seconds),
            n=len(errors.row),
            n_failed=int(run.errors.failed[:, h].sum()),
            levels=drawn.levels(len(errors.seeds)),
            loss=loss,
            minus={
                label: Minus(minus(other, "distance_error_m", h), loss_minus[label]) for label, other in others.items()
            },
        )
        for h, seconds in enumerate(HORIZONS)
    ]


def headlines(cases: Cases, sampling: Sampling) -> list[Headline]:
    """Compare each trained model with `kinematic` after 5 s."""
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
                levels=drawn.levels(len(errors.seeds)),
                distance_error_m=float(errors.distance().mean()),
                other=REFERENCE,
                relative=ratio.mean,
                ci95=ratio.ci95,
            )
        )
    return result


def _counterpart(together: Mapping[Case, SeededErrors], other: str, case: Case) -> SeededErrors | None:
    """Return the errors of another model with the same start and terrain lookup, or without a lookup.

    A model that does not read the terrain is compared on the map, which decides, else at recorded places.
    """
    alike = {key: errors for key, errors in together.items() if (key.label, key.start) == (other, case.start)}
    for key, errors in alike.items():
        if (key.lookup, key.feature_set) in ((case.lookup, case.feature_set), (None, None)):
            return errors
    by_lookup = {key.lookup: errors for key, errors in reversed(alike.items())} if case.lookup is None else {}
    return by_lookup.get("map", by_lookup.get("recorded"))


def band_rows(errors: Mapping[Case, SeededErrors], windows: EvaluatedWindows, sampling: Sampling) -> list[BandRow]:
    """Return the distance errors of every case by speed band and horizon, over all its runs on the same windows."""
    rows = []
    for name, mine in members(windows).items():
        for case, every in errors.items():
            some = every.take(np.flatnonzero(mine))
            drawn = sampling.on(some)
            rows += [
                BandRow(
                    **asdict(case),
                    band=name,
                    horizon_s=float(seconds),
                    n=int(mine.sum()),
                    distance_error_m=summary(some.component("distance_error_m", h), drawn),
                    levels=drawn.levels(len(some.seeds)),
                )
                for h, seconds in enumerate(HORIZONS)
            ]
    return rows


def by_reading(rows: Sequence[ResultRow]) -> list[list[ResultRow]]:
    """Group pooled rows that differ only in the horizon, in ascending order."""
    result: dict[Case, list[ResultRow]] = {}
    for row in rows:
        result.setdefault(_case(row), []).append(row)
    return list(result.values())


def pooled_rows(rows: Sequence[ResultRow]) -> list[ResultRow]:
    """Return one row for each case and horizon: over all runs if a model has several."""
    first: dict[tuple[Case, float], ResultRow] = {}
    for row in rows:
        first.setdefault((_case(row), row.horizon_s), row)
    return list(first.values())


def run_rows(rows: Sequence[ResultRow]) -> list[ResultRow]:
    """Return the rows of single runs of models with several runs."""
    pooled = {id(row) for row in pooled_rows(rows)}
    return [row for row in rows if id(row) not in pooled]


def single_rows(rows: Sequence[ResultRow]) -> list[ResultRow]:
    """Return one row per run, so that each prediction counts once."""
    several = {_case(row) for row in run_rows(rows)}
    return [row for row in rows if _case(row) not in several or (row.seed, row.fold) != (None, None)]


def last_rows(rows: Sequence[ResultRow]) -> list[ResultRow]:
    """Return the rows at the last horizon."""
    return [row for row in rows if row.horizon_s == HORIZONS[-1]]


def _case(row: ResultRow) -> Case:
    return Case(row.model, row.variant, row.start, row.lookup, row.feature_set)


def write_metrics(path: Path, metrics: msgspec.Struct) -> None:
    """Write metrics.json, whole or not at all, as strict JSON; numbers that are not finite become null."""
    write_text(path, msgspec.json.format(msgspec.json.encode(metrics), indent=2).decode() + "\n")


def provenance(command: str, seed: int, device: torch.device | str) -> Provenance:
    """Return the provenance of results computed now on this machine.

    Args:
        command: as typed; empty: that of this process.
        seed: of the resampling.
        device: of the models.
    """
    names, device = ("offpiste", "torch", "numpy", "scipy"), torch.device(device)
    ran_on = torch.cuda.get_device_name(device) if device.type == "cuda" else device.type
    return Provenance(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command or shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        machine=f"{_processor()}, {os.cpu_count()} cores, {platform.system()}; models ran on {ran_on}",
        versions={"python": platform.python_version(), **{name: version(name) for name in names}},
        seed=seed,
    )


def _processor() -> str:
    """Return the name of the processor, or its architecture if unknown."""
    try:
        found = re.search(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text("utf-8"), re.MULTILINE)
    except OSError:
        found = None
    return found[1] if found else platform.machine()
