"""Schema of metrics.json: the numbers of an evaluation, and what made them (docs/formats.md)."""

import os
import platform
import shlex
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import msgspec
import torch

from offpiste.core.errors import RunError
from offpiste.core.files import write_text
from offpiste.core.limits import parsed, read_small
from offpiste.evaluation.intervals import Levels, PairedDifference, Statistics

SCHEMA = 2


class Minus(msgspec.Struct, frozen=True):
    """Paired differences to another model on the same windows; negative where this one is better."""

    distance_error_m: PairedDifference
    loss: PairedDifference


class Labelled:
    """Labels of a result in tables and figures."""

    __slots__ = ()
    model: str
    variant: str
    lookup: Literal["recorded", "map"] | None
    feature_set: str | None

    @property
    def label(self) -> str:
        """The model's name, and its variant if it has one."""
        return label(self.model, self.variant)

    @property
    def reading_label(self) -> str:
        """The model's label, and where it reads the terrain."""
        return reading_label(self.label, self.lookup, self.feature_set)


class ResultRow(Labelled, msgspec.Struct, frozen=True, kw_only=True):
    """Results of one model, start, terrain lookup and horizon.

    Attributes:
        seed, fold: of the run; both None where several runs are taken together (`offpiste.evaluation.errors.pool`).
        feature_set: read at recorded places, in datasets with features by distance; None otherwise.
        lookup: None for models that do not read the terrain.
        n: number of windows.
        n_failed: number of predictions that are not finite at this horizon; any makes the mean infinite, null in JSON.
        levels: numbers of drives, blocks and seeds that intervals are drawn from.
        loss: over all steps up to 5 s, whatever the horizon of the row.
        minus: paired differences by the other model's label (its name, and its variant if it has one).
    """

    model: str
    variant: str
    seed: int | None
    fold: int | None
    start: Literal["causal", "smoothed"]
    feature_set: str | None
    lookup: Literal["recorded", "map"] | None
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


class BandRow(Labelled, msgspec.Struct, frozen=True, kw_only=True):
    """Distance errors of one model, start, terrain lookup and horizon, on windows that start in a band of speeds.

    Attributes:
        band: in words (`offpiste.evaluation.speed_bands`): speeds at the start, or "reverse".
        n: number of windows in it.
        levels: numbers of drives, blocks and seeds that intervals are drawn from; None in files that are older.
    """

    model: str
    variant: str
    start: Literal["causal", "smoothed"]
    feature_set: str | None
    lookup: Literal["recorded", "map"] | None
    band: str
    horizon_s: float
    n: int
    distance_error_m: Statistics
    levels: Levels | None = None


class Headline(msgspec.Struct, frozen=True, kw_only=True):
    """A model's distance error at 5 s, and how it compares with `other`'s: -0.3 is 30 % below."""

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
    """Numbers of the evaluated windows.

    Attributes:
        driven_in_training: share of the part's path that training passes within 5 m.
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
    """The loss's components: their weights, and the mean square errors they are divided by."""

    weights: dict[str, float]
    scale: dict[str, float]


class Provenance(msgspec.Struct, frozen=True):
    """When, where, by which command and with which versions the numbers were made."""

    date: str
    command: str
    machine: str
    versions: dict[str, str]
    seed: int


class Metrics(msgspec.Struct, frozen=True, kw_only=True):
    """Everything in metrics.json.

    Attributes:
        bands: the same windows by the speed at which they start; empty in files that are older.
        assumptions: of the dataset (`offpiste.dataset.assumptions`); empty in files that are older.
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
    warnings: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()
    features: bool = True
    bands: list[BandRow] = []


def label(model: str, variant: str) -> str:
    """Name of a model in tables and figures."""
    return f"{model} ({variant})" if variant else model


def reading_label(model: str, lookup: str | None, feature_set: str | None = None) -> str:
    """A model's label, its terrain lookup, and the distance of its feature set unless that is hindsight."""
    distance = "" if feature_set in (None, "hindsight") else f" {feature_set} m"
    return f"{model} · {lookup}{distance}" if lookup else model


def pooled_rows(rows: list[ResultRow]) -> list[ResultRow]:
    """One row per result: the row over all runs where a model has several."""
    several = {_case(row) for row in rows if row.seed is None and row.fold is None}
    return [row for row in rows if (row.seed is None and row.fold is None) or _case(row) not in several]


def run_rows(rows: list[ResultRow]) -> list[ResultRow]:
    """The single runs of models that have several."""
    pooled = {id(row) for row in pooled_rows(rows)}
    return [row for row in rows if id(row) not in pooled]


def single_rows(rows: list[ResultRow]) -> list[ResultRow]:
    """One row per run: each prediction counts in one of them, and not once more over all runs."""
    several = {_case(row) for row in run_rows(rows)}
    return [row for row in rows if row.seed is not None or row.fold is not None or _case(row) not in several]


def write_metrics(path: Path, metrics: Metrics) -> None:
    """Write metrics.json, whole or not at all: strict JSON, null for what is not finite."""
    write_text(path, msgspec.json.format(msgspec.json.encode(metrics), indent=2).decode() + "\n")


def read_metrics(path: Path) -> Metrics:
    """Read metrics.json; null in a statistic becomes nan.

    Raises:
        RunError: no such file, not strict JSON, or of another version.
    """
    how = "give the metrics.json that `offpiste evaluate` wrote"
    try:
        content = parsed(read_small(path), msgspec.json.decode)
        if isinstance(content, dict) and content.get("schema") != SCHEMA:
            raise RunError(f"schema {content.get('schema')}, this offpiste reads {SCHEMA}", where=path, how=how)
        return msgspec.convert(_with_nan(content), type=Metrics)
    except (OSError, ValueError, msgspec.MsgspecError) as error:
        raise RunError(f"not the numbers of an evaluation: {error}", where=path, how=how) from error


def _with_nan(content: Any, names: tuple[str, ...] = ("model", "seed", "fold", "lookup", "feature_set")) -> Any:
    """The same with nan for null, except where null has a meaning of its own."""
    if isinstance(content, dict):
        return {key: value if key in names else _with_nan(value, names) for key, value in content.items()}
    if isinstance(content, list):
        return [_with_nan(value, names) for value in content]
    return float("nan") if content is None else content


def _case(row: ResultRow) -> tuple[str, str, str, str | None, str | None, float]:
    return row.model, row.variant, row.start, row.feature_set, row.lookup, row.horizon_s


def provenance(command: str, seed: int, device: torch.device | str) -> Provenance:
    """Provenance of numbers made now on this machine.

    Args:
        command: as typed; empty: this process's own.
        seed: of the resampling.
        device: on which models ran.
    """
    names = ("offpiste", "torch", "numpy", "scipy")
    return Provenance(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command or shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        machine=f"{_processor()}, {os.cpu_count()} cores, {platform.system()}; models ran on {_device(device)}",
        versions={"python": platform.python_version(), **{name: version(name) for name in names}},
        seed=seed,
    )


def _device(device: torch.device | str) -> str:
    device = torch.device(device)
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type


def _processor() -> str:
    """The processor's name where the system gives it, else its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
