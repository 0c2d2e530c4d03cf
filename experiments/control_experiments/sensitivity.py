"""Predicted against simulated differences between two grounds: slope, correlation, what is left over."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure

from offpiste.evaluation.intervals import Levels, PairedDifference, Sampling
from offpiste.report.text_table import TextTable, interval, number

ABOUT = (
    "Differences of the place after 5 s between two grounds, ahead and to the left at the start, from the same state "
    "under the same commands; a model reads the map as it was at the window's start, where it predicts to be. Slope: "
    "of the predicted on the simulated difference, through zero (1: as the simulator; 0: tells nothing apart). Left "
    "over: root mean square of what is not predicted, relative to predicting none. 95 % intervals over "
    "drives and blocks of 10 s; the predictions of a model's runs are averaged."
)


class Sensitivity(msgspec.Struct, frozen=True, kw_only=True):
    """How a model's differences follow the simulator's; ahead and to the left together unless said."""

    model: str
    n: int
    levels: Levels
    simulated_rms_m: float
    predicted_rms_m: float
    slope: PairedDifference
    correlation: PairedDifference
    correlation_ahead: PairedDifference
    left_over: PairedDifference


@dataclass(frozen=True)
class Differences:
    """Differences of the place after 5 s, in the frame of each window's start [m].

    Attributes:
        drive, row: of the windows.
    """

    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    simulated: Float[np.ndarray, "n 2"]
    predicted: Float[np.ndarray, "n 2"]


def sensitivity(model: str, result: Differences, seed: int = 0) -> Sensitivity:
    """Slope, correlation and what is left over, each with its interval."""
    drawn = Sampling(seed).on(result)
    s, p = result.simulated, result.predicted
    ss, pp, sp, rest = ((a * b).sum(axis=1) for a, b in ((s, s), (p, p), (s, p), (s - p, s - p)))
    ahead = s[:, 0] ** 2, p[:, 0] ** 2, s[:, 0] * p[:, 0]

    def ratio(values: tuple[np.ndarray, ...], of: Callable[..., np.ndarray]) -> PairedDifference:
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = float(of(*(value.mean(keepdims=True) for value in values))[0])
            return PairedDifference(mean, drawn.interval(of(*(drawn.means(value) for value in values))))

    return Sensitivity(
        model=model,
        n=len(s),
        levels=drawn.levels(),
        simulated_rms_m=float(np.sqrt(ss.mean())),
        predicted_rms_m=float(np.sqrt(pp.mean())),
        slope=ratio((sp, ss), np.divide),
        correlation=ratio((ss, pp, sp), _correlation),
        correlation_ahead=ratio(ahead, _correlation),
        left_over=ratio((rest, ss), lambda a, b: np.sqrt(a / b)),
    )


def _correlation(ss: np.ndarray, pp: np.ndarray, sp: np.ndarray) -> np.ndarray:
    """About zero, not about the means: which of two grounds is called the other one is chance."""
    return sp / np.sqrt(ss * pp)


def sensitivity_table(rows: Sequence[Sensitivity]) -> TextTable:
    """A line a model."""

    def message(value: PairedDifference) -> str:
        return f"{number(value.mean)} {interval(value.ci95)}"

    lines = [
        (
            t.model,
            f"{t.n} ({t.levels.drives} drives, {t.levels.blocks} blocks)",
            f"{t.simulated_rms_m:.2f}",
            f"{t.predicted_rms_m:.2f}",
            *(message(value) for value in (t.slope, t.correlation, t.correlation_ahead, t.left_over)),
        )
        for t in rows
    ]
    names = ("model", "windows", "simulated [m]", "predicted [m]", "slope", "correlation", "of it ahead", "left over")
    return TextTable("Sensitivity to the ground of twins", names, tuple(lines), ABOUT)


def draw_sensitivity(result: Mapping[str, Differences], rows: Sequence[Sensitivity]) -> Figure:
    """Predicted against simulated differences, a column a model, ahead and to the left."""
    figure = Figure(figsize=(1.0 + 2.8 * len(result), 5.6), layout="constrained")
    panels = figure.subplots(2, len(result), squeeze=False, sharex="row", sharey="row")
    for column, (model, differences) in enumerate(result.items()):
        for line, name in enumerate(("ahead", "to the left")):
            axes = panels[line, column]
            simulated, predicted = differences.simulated[:, line], differences.predicted[:, line]
            reach = 1.1 * float(np.quantile(np.abs(simulated), 0.98))
            axes.plot((-reach, reach), (-reach, reach), color="black", linewidth=0.8)
            axes.plot(simulated, predicted, ".", markersize=4, alpha=0.5, color="#1f5fa8")
            axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel=f"simulated, {name} [m]")
            axes.grid(color="#e5e5e5", linewidth=0.5)
            if column == 0:
                axes.set_ylabel(f"predicted, {name} [m]")
        panels[0, column].set_title(f"{model}: slope {rows[column].slope.mean:.2f}", fontsize=10)
    return figure
