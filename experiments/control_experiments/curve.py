"""Learning curves: the position error on the map against the hours of driving that models train on.

Amounts are nested: each holds the drives of the smaller ones. All are validated and tested on the same drives.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Int
from matplotlib.figure import Figure

from experiments.control_experiments.data import claim_settings, true_ground
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.runs import trained_seeds
from experiments.control_experiments.tables import percent, write_control
from offpiste.core.conventions import DT
from offpiste.core.errors import DatasetError
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.evaluation.errors import SeededErrors
from offpiste.evaluation.intervals import PairedDifference, Resampling, Sampling, relative
from offpiste.report.text_table import TextTable, interval, number
from offpiste.reproduction.results import MAP, errors_of, runs_of, same_windows
from offpiste.reproduction.runs import evaluation_windows
from offpiste.training.config import TrainConfig
from offpiste.training.run import Run

logger = logging.getLogger("experiments")

ORACLE = "oracle"
"""Name of `df` on the true ground."""

SMALLEST_BATCH = 128
ABOUT = (
    "Distance after 5 s on the map as it was at the window's start, read at predicted places (the oracle: on the whole "
    "true map), all on the same windows of the test part, with 95 % intervals over drives, blocks of 10 s and seeds. "
    "Training drives are drawn once; each amount holds those of the smaller ones. All take as many steps of the "
    "optimiser. Change: against the amount before. Against b: of as many hours, and the change of that since the least "
    "hours, in points."
)


@dataclass(frozen=True)
class Curve:
    """What is trained.

    Attributes:
        hours: of driving, each with models of its own.
        models: beside the oracle.
        oracle: whether `df` on the true ground is trained too, for which all drives are extracted a second time.
        seed: of the order in which drives are drawn.
    """

    hours: tuple[float, ...] = (0.3, 0.6, 1.2, 2.5, 5.0)
    models: tuple[str, ...] = ("parametric", "b", "cf", "dc")
    oracle: bool = True
    seed: int = 0


class Point(msgspec.Struct, frozen=True, kw_only=True):
    """A model trained on so many hours.

    Attributes:
        hours: that there were, to the drive.
        error_m, ci95: mean distance after 5 s and its 95 % interval [m].
        against_less: relative difference to the amount before; None for the smallest.
        against_b: relative to `b` trained on as many hours; None of `b`, or without it.
        gained_since: `against_b` less that of the smallest amount; None for the smallest.
    """

    model: str
    hours: float
    error_m: float
    ci95: tuple[float, float]
    against_less: PairedDifference | None
    against_b: PairedDifference | None = None
    gained_since: PairedDifference | None = None


def curve_control(of: Reproduced, out: Path, curve: Curve, seeds: int) -> Path:
    """Train the models and the oracle on each amount of driving, and evaluate them on the reproduction's windows.

    Raises:
        DatasetError: there is less driving than the smallest amount.
    """
    claim_settings(out / "curve", {"seed": curve.seed})
    windows = Windows(of.dataset, "test")
    index = evaluation_windows(windows, MAP, of.size.stride)
    truth = true_ground(of, out / "oracle") if curve.oracle else None
    whole = hours_of(of.dataset)
    errors: dict[tuple[str, float], SeededErrors] = {}
    for names in amounts(of.dataset, curve):
        mine = training_on(of.dataset, names)
        hours = hours_of(mine)
        folder = out / "curve" / f"{hours:.2f}h"
        config = at_size(of.size.train, hours / whole)
        for model in curve.models:
            if hours == whole and of.has(model):
                runs = of.runs(model)[:seeds]
            else:
                runs = trained_seeds(mine, _config(of, model, config), folder / "runs", seeds)
            errors[model, hours] = _on_maps(runs, windows, index, folder / "evaluated")
        if truth is not None:
            there = Windows(truth, "test")
            runs = trained_seeds(training_on(truth, names), replace(config, model="df"), folder / ORACLE, seeds)
            same = same_windows(windows, index, there)
            errors[ORACLE, hours] = _on_maps(runs, there, same, folder / "evaluated" / ORACLE)
        found = (f"{model} {mine.distance().mean():.3f} m" for (model, at), mine in errors.items() if at == hours)
        logger.info(f"{hours:.2f} h: {', '.join(found)}")
    points = _points(errors)
    results = {"control": "curve", "curve": curve, "points": points}
    return write_control(out / "curve", [_table(points)], results, {"curve": draw_curves(points)})


def _on_maps(runs: Sequence[Run], windows: Windows, index: Int[np.ndarray, " n"], kept: Path) -> SeededErrors:
    """Errors of runs of one model on the map, at predicted places; distances do not depend on the units of the loss."""
    return runs_of([errors_of(run, windows, index, MAP, scale=runs[0].scale, kept=kept) for run in runs])


def amounts(dataset: Dataset, curve: Curve) -> list[set[str]]:
    """Names of the training drives of each amount: as many, in an order drawn by the seed, as come nearest to it.

    Raises:
        DatasetError: there is less driving than the smallest amount.
    """
    training = [drive for drive in dataset.drives if (drive.part == PARTS.index("train")).any()]
    order = np.random.default_rng(curve.seed).permutation(len(training))
    names = [training[i].name for i in order]
    driven = np.cumsum([DT * len(training[i].part) / 3600 for i in order])
    if not len(driven) or driven[-1] < min(curve.hours):
        has = driven[-1] if len(driven) else 0.0
        raise DatasetError(f"has {has:.2f} h to train on", where=dataset.path, how="give smaller --curve.hours")
    counts = {1 + int(np.abs(driven - hours).argmin()) for hours in curve.hours}
    return [set(names[:count]) for count in sorted(counts)]


def training_on(dataset: Dataset, names: set[str]) -> Dataset:
    """The dataset with only these of the drives that train."""
    train = PARTS.index("train")
    return replace(dataset, drives=tuple(d for d in dataset.drives if d.name in names or not (d.part == train).any()))


def hours_of(dataset: Dataset) -> float:
    """Hours of driving to train on."""
    return DT * sum(int((drive.part == PARTS.index("train")).sum()) for drive in dataset.drives) / 3600


def at_size(config: TrainConfig, share: float) -> TrainConfig:
    """Settings that take as many steps of the optimiser on a share of the windows: smaller batches, more epochs."""
    batch = min(config.batch, max(SMALLEST_BATCH, round(config.batch * share)))
    more = batch / (config.batch * share)
    epochs, bicycle = (math.ceil(max(more, 1.0) * each - 1e-9) for each in (config.epochs, config.bicycle_epochs))
    return replace(config, batch=batch, epochs=epochs, bicycle_epochs=bicycle, seed=0)


def _config(of: Reproduced, model: str, config: TrainConfig) -> TrainConfig:
    member = of.member(model)
    return replace(config, model=model, codes=member.codes, pca=member.pca)


def _points(errors: Mapping[tuple[str, float], SeededErrors]) -> list[Point]:
    points = []
    for model in dict.fromkeys(model for model, _ in errors):
        before: SeededErrors | None = None
        least = min(hours for name, hours in errors if name == model)
        for hours, mine in ((hours, each) for (name, hours), each in errors.items() if name == model):
            drawn, distance = Sampling().on(mine), mine.distance()
            blind, first = errors.get(("b", hours)), errors.get(("b", least))
            points.append(
                Point(
                    model=model,
                    hours=hours,
                    error_m=float(distance.mean()),
                    ci95=drawn.interval(drawn.means(distance)),
                    against_less=None if before is None else relative(distance, before.distance(), drawn),
                    against_b=None if model == "b" or blind is None else relative(distance, blind.distance(), drawn),
                    gained_since=None
                    if before is None or model == "b" or blind is None or first is None
                    else _change((mine, blind), (errors[model, least], first), drawn),
                )
            )
            before = mine
    return points


def _change(
    now: tuple[SeededErrors, SeededErrors], then: tuple[SeededErrors, SeededErrors], drawn: Resampling
) -> PairedDifference:
    """Difference of two relative differences, each of a model and its baseline, on the same windows."""
    (a, b), (c, d) = ([each.distance() for each in pair] for pair in (now, then))
    change = drawn.means(a) / drawn.means(b) - drawn.means(c) / drawn.means(d)
    return PairedDifference(float(a.mean() / b.mean() - c.mean() / d.mean()), drawn.interval(change))


def _table(points: Sequence[Point]) -> TextTable:
    lines = [
        (
            point.model,
            f"{point.hours:.2f}",
            number(point.error_m),
            interval(point.ci95, 2),
            *(
                "" if each is None else percent(each)
                for each in (point.against_less, point.against_b, point.gained_since)
            ),
        )
        for point in points
    ]
    names = ("model", "hours", "error [m]", "95 %", "change", "against b", "since the least hours")
    return TextTable("Learning curves", names, tuple(lines), ABOUT)


def draw_curves(points: Sequence[Point]) -> Figure:
    """Distance error against hours of driving, both on logarithmic axes, a line a model with its interval."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for model in dict.fromkeys(point.model for point in points):
        mine = [point for point in points if point.model == model]
        hours, error = np.array([(point.hours, point.error_m) for point in mine]).T
        low, high = np.array([point.ci95 for point in mine]).T
        colour, line = ("black", "--") if model == ORACLE else (MODELS[model].colour, "-")
        axes.plot(hours, error, marker="o", label=model, color=colour, linestyle=line)
        axes.fill_between(hours, low, high, color=colour, alpha=0.12, linewidth=0)
    axes.set(xscale="log", yscale="log", xlabel="driving to train on [h]", ylabel="distance error after 5 s [m]")
    amounts = sorted({point.hours for point in points})
    axes.set_xticks(amounts, [f"{hours:.2g}" for hours in amounts])
    axes.minorticks_off()
    shown = [each for point in points for each in (*point.ci95, point.error_m) if np.isfinite(each)]
    ticks = np.geomspace(min(shown), max(shown), 6)
    axes.set_yticks(ticks, [f"{tick:.2f}" for tick in ticks])
    axes.grid(color="#e5e5e5", linewidth=0.5)
    axes.legend(frameon=False)
    return figure
