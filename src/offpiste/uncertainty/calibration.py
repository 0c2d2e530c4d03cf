"""Whether spreads are calibrated: how many errors lie in the regions that should hold half, 80 and 95 % of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from offpiste.evaluation.intervals import Resampling
from offpiste.report.figure import plain
from offpiste.report.text_table import TextTable, interval, number
from offpiste.uncertainty.fit import Residuals
from offpiste.uncertainty.spread import INTERVAL, Spread
from offpiste.uncertainty.student import area_under_curve, crps, probability_within

HORIZONS: Final = (1.0, 3.0, 5.0)
"""Moments that are evaluated [s]."""

AT: Final = [round(horizon / INTERVAL) - 1 for horizon in HORIZONS]
"""Numbers of these moments among those of a spread."""

NOMINAL: Final = (0.5, 0.8, 0.95)
"""Share of errors that each region should hold."""

WORST: Final = 0.1
"""Share of windows, those with the largest errors, that a spread is to tell from the others."""

ALL: Final = "all"
"""Name of the row of all windows."""

ABOUT: Final = (
    "Share of position errors within the regions that should hold 50, 80 and 95 % of them, with 95 % intervals over "
    "drives and blocks of 10 s. CRPS: of the errors along and across the heading, less is better. AUROC: the "
    "probability that a window among the tenth with the largest errors has a larger spread than another window (0.5 is "
    "chance); beside it the same by the speed at the start alone."
)


@dataclass(frozen=True)
class ErrorsWithScales:
    """Errors of position and the scales predicted for them, at the moments of a spread.

    Attributes:
        error, scale: along and across the predicted heading [m].
        freedom: degrees of freedom of the errors.
        speed: at the start [m/s].
    """

    error: Float[np.ndarray, "N K 2"]
    scale: Float[np.ndarray, "N K 2"]
    freedom: float
    speed: Float[np.ndarray, " N"]

    @property
    def within(self) -> Float[np.ndarray, "N H"]:
        """Probability of the region that each error lies on, at each of `HORIZONS`."""
        squared = np.square(self.error[:, AT] / self.scale[:, AT]).sum(axis=-1)
        return probability_within(squared, self.freedom)


def errors_with_scales(spread: Spread, residuals: Residuals) -> ErrorsWithScales:
    """Residuals beside what a spread predicts of them."""
    scale, speed = spread(residuals.inputs).detach().numpy(), residuals.inputs[:, 0, 0].numpy()
    return ErrorsWithScales(residuals.error.numpy(), scale, float(spread.freedom.detach()), speed)


class CalibrationRow(msgspec.Struct, frozen=True, kw_only=True):
    """How well errors were predicted for some windows after some time.

    Attributes:
        windows: which ones, by name; n: how many.
        horizon: [s].
        error_m: mean distance [m].
        scale_m: mean of the predicted scales, along and across together [m].
        coverage, ci95: share within each region of `NOMINAL`, and its interval.
        crps_m: mean over both components [m].
        auroc, auroc_by_speed: how well spread, and speed alone, tell the `WORST` windows from others (0.5: not at all).
    """

    run: str
    windows: str
    horizon: float
    n: int
    error_m: float
    scale_m: float
    coverage: tuple[float, ...]
    ci95: tuple[tuple[float, float], ...]
    crps_m: float
    auroc: float
    auroc_by_speed: float


def calibration_rows(
    run: str, errors: ErrorsWithScales, groups: Mapping[str, Bool[np.ndarray, " N"]], drawn: Resampling
) -> list[CalibrationRow]:
    """A row for all windows, and one for each group, at each horizon.

    Args:
        run: name of the run.
        errors: of the windows.
        groups: which windows belong to each.
        drawn: of the same windows, for intervals of the row of all of them.
    """
    scale, error, within, rows = errors.scale, errors.error, errors.within, list[CalibrationRow]()
    for place, (horizon, k) in enumerate(zip(HORIZONS, AT, strict=True)):
        distance, reach = np.linalg.norm(error[:, k], axis=-1), np.linalg.norm(scale[:, k], axis=-1)
        score = crps(error[:, k], scale[:, k], errors.freedom).mean(axis=-1)
        for name, mine in ({ALL: np.ones(len(error), bool)} | dict(groups)).items():
            worst = distance[mine] >= np.quantile(distance[mine], 1 - WORST)
            covered = within[mine, place, None] <= np.array(NOMINAL)
            rows.append(
                CalibrationRow(
                    run=run,
                    windows=name,
                    horizon=horizon,
                    n=int(mine.sum()),
                    error_m=float(distance[mine].mean()),
                    scale_m=float(reach[mine].mean()),
                    coverage=tuple(covered.mean(axis=0).tolist()),
                    ci95=_intervals(covered, drawn) if name == ALL else ((np.nan, np.nan),) * len(NOMINAL),
                    crps_m=float(score[mine].mean()),
                    auroc=area_under_curve(reach[mine], worst),
                    auroc_by_speed=area_under_curve(errors.speed[mine], worst),
                )
            )
    return rows


def _intervals(covered: Bool[np.ndarray, "N R"], drawn: Resampling) -> tuple[tuple[float, float], ...]:
    return tuple(drawn.interval(drawn.means(column.astype(float))) for column in covered.T)


def calibration_table(rows: list[CalibrationRow]) -> TextTable:
    """A line a run, group of windows and horizon."""
    names = ("run", "windows", "after", "n", "error [m]", "50 %", "80 %", "95 %", "CRPS [m]", "AUROC", "by speed")
    lines = [
        (
            row.run,
            row.windows,
            f"{row.horizon:g} s",
            f"{row.n}",
            number(row.error_m),
            *(_covered(share, bounds) for share, bounds in zip(row.coverage, row.ci95, strict=True)),
            number(row.crps_m),
            number(row.auroc),
            number(row.auroc_by_speed),
        )
        for row in rows
    ]
    return TextTable("Calibration", names, tuple(lines), ABOUT, left=3)


def _covered(share: float, bounds: tuple[float, float]) -> str:
    """A share and its interval in percent."""
    return f"{number(100 * share, 0)} {interval((100 * bounds[0], 100 * bounds[1]), 0)}"


def draw_calibration(within: Mapping[str, Float[np.ndarray, "N H"]]) -> Figure:
    """Share of errors within regions against what they should hold, a panel a run, a line a horizon.

    Args:
        within: by run, the probability of the region that each window's error lies on, at each of `HORIZONS`.
    """
    figure = Figure(figsize=(3.6 * len(within), 3.6), layout="constrained")
    nominal = np.linspace(0, 1, 101)
    for axes, (run, values) in zip(figure.subplots(1, len(within), squeeze=False)[0], within.items(), strict=True):
        plain(axes, run)
        axes.plot([0, 100], [0, 100], color="#999999", linewidth=0.8)
        for horizon, column, colour in zip(HORIZONS, values.T, ("#56b4e9", "#0072b2", "black"), strict=True):
            share = np.searchsorted(np.sort(column), nominal, side="right") / len(column)
            axes.plot(100 * nominal, 100 * share, color=colour, label=f"{horizon:g} s")
        axes.set(xlabel="errors that should lie within [%]", ylabel="errors that do [%]", aspect="equal")
        axes.legend(frameon=False)
    return figure
