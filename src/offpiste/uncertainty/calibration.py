"""Calibration of spreads: share of errors within their 50, 80 and 95 % regions; `offpiste calibrate`."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Bool, Float
from scipy import special, stats

from offpiste.core.errors import RunError
from offpiste.core.files import check_folder, unfinished, write_text
from offpiste.core.shipped import names_apart, run_folder
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_windows import EvaluatedWindows, members
from offpiste.evaluation.intervals import NO_INTERVAL, Resampling, Sampling
from offpiste.evaluation.report import REPORT_FILES, UNFINISHED
from offpiste.report.chart import Chart, Line, Panel, draw
from offpiste.report.figure import write_png
from offpiste.report.text_table import TextTable, interval, number
from offpiste.training.checkpoint import load_json, load_tensors, save_beside_weights
from offpiste.training.run import Run, Stretch, load_run, overlap_with, refuse_seen, refuse_unfit, seen_stretches
from offpiste.uncertainty.fit import (
    FILE,
    Residuals,
    SpreadSettings,
    fit_spread,
    load_spread,
    residuals_on_maps,
)
from offpiste.uncertainty.novelty import keep_memory_bank
from offpiste.uncertainty.spread import INTERVAL, Spread, probability_within

logger = logging.getLogger(__name__)

PART: Final = "test"
"""Part of the dataset on which calibration is evaluated."""

HORIZONS: Final = (1.0, 3.0, 5.0)
"""Times after the start that are evaluated [s]."""

AT: Final = [round(horizon / INTERVAL) - 1 for horizon in HORIZONS]
"""Indices of these times among the moments of a spread."""

NOMINAL: Final = (0.5, 0.8, 0.95)
"""Nominal probability of each region."""

WORST: Final = 0.1
"""Share of the windows with the largest errors, which a large spread should indicate."""

ALL: Final = "all"
"""Name of the row for all windows."""

ABOUT: Final = (
    "Share of position errors within the 50, 80 and 95 % regions, with 95 % intervals over drives and blocks of 10 s. "
    "CRPS: of the errors along and across the heading, less is better. AUROC: probability that a window among "
    "the tenth with the largest errors has a larger spread than another window (0.5 is chance); by speed: the same for "
    "the speed at the start in place of the spread."
)


class CalibrationRow(msgspec.Struct, frozen=True, kw_only=True):
    """Calibration on a group of windows at a horizon.

    Attributes:
        windows: name of the group; n: number of windows.
        horizon: [s].
        error_m: mean distance error [m].
        scale_m: mean norm of the predicted scales [m].
        coverage, ci95: share within each region of `NOMINAL`, and its interval.
        crps_m: mean over both components [m].
        auroc, auroc_by_speed: how well the spread, or the speed, separates the `WORST` windows (0.5: not at all).
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
    run: str,
    spread: Spread,
    residuals: Residuals,
    groups: Mapping[str, Bool[np.ndarray, " N"]],
    drawn: Resampling,
) -> tuple[list[CalibrationRow], Float[np.ndarray, "N H"]]:
    """Return a row for all windows and one for each group, at each horizon.

    The second result is the probability of the region that ends at each error, at each of `HORIZONS`.

    Args:
        run: name of the run.
        groups: windows of each group.
        drawn: resamples of all windows, for the intervals of their row.
    """
    freedom, speed = float(spread.freedom.detach()), residuals.inputs[:, 0, 0].numpy()
    scale, error = spread(residuals.inputs).detach().numpy()[:, AT], residuals.error.numpy()[:, AT]
    distance, reach = np.linalg.norm(error, axis=-1), np.linalg.norm(scale, axis=-1)
    score = crps(error, scale, freedom).mean(axis=-1)
    within = probability_within(np.square(error / scale).sum(axis=-1), freedom)
    rows = list[CalibrationRow]()
    for at, horizon in enumerate(HORIZONS):
        for name, mine in ({ALL: np.ones(len(error), bool)} | dict(groups)).items():
            worst = distance[mine, at] >= np.quantile(distance[mine, at], 1 - WORST)
            covered = (within[mine, at] <= np.array(NOMINAL)[:, None]).astype(float)
            intervals = [drawn.interval(drawn.means(each)) if name == ALL else NO_INTERVAL for each in covered]
            rows.append(
                CalibrationRow(
                    run=run,
                    windows=name,
                    horizon=horizon,
                    n=int(mine.sum()),
                    error_m=float(distance[mine, at].mean()),
                    scale_m=float(reach[mine, at].mean()),
                    coverage=tuple(covered.mean(axis=1).tolist()),
                    ci95=tuple(intervals),
                    crps_m=float(score[mine, at].mean()),
                    auroc=area_under_curve(reach[mine, at], worst),
                    auroc_by_speed=area_under_curve(speed[mine], worst),
                )
            )
    return rows, within


def calibration_table(rows: Sequence[CalibrationRow]) -> TextTable:
    """Return a table with a line per run, group and horizon."""
    lines = []
    for row in rows:
        shares = zip(row.coverage, row.ci95, strict=True)
        covered = (f"{number(100 * share, 0)} {interval((100 * low, 100 * high), 0)}" for share, (low, high) in shares)
        scores = map(number, (row.crps_m, row.auroc, row.auroc_by_speed))
        where = (row.run, row.windows, f"{row.horizon:g} s")
        lines.append((*where, f"{row.n}", number(row.error_m), *covered, *scores))
    names = ("run", "windows", "after", "n", "error [m]", "50 %", "80 %", "95 %", "CRPS [m]", "AUROC", "by speed")
    return TextTable("Calibration", names, lines, ABOUT, left=3)


def calibration_chart(within: Mapping[str, Float[np.ndarray, "N H"]]) -> Chart:
    """Describe the share of errors within regions against their probability: a panel per run, a line per horizon.

    Args:
        within: by run, the probability of the region that ends at each error.
    """
    nominal, sides = np.linspace(0, 1, 101), (0.0, 100.0)
    panels = []
    for run, values in within.items():
        lines = [Line("", np.array(sides), np.array(sides), "#999999", width=0.8)]
        for horizon, column, colour in zip(HORIZONS, values.T, ("#56b4e9", "#0072b2", "#000000"), strict=True):
            share = np.searchsorted(np.sort(column), nominal, side="right") / len(column)
            lines.append(Line(f"{horizon:g} s", 100 * nominal, 100 * share, colour))
        axes = ("nominal share of errors [%]", "observed share [%]")
        panels.append(Panel(*axes, lines, title=run, x_range=sides, y_range=sides, equal=True))
    return Chart(panels)


def crps(error: Float[np.ndarray, "*B"], scale: Float[np.ndarray, "*B"], freedom: float) -> Float[np.ndarray, "*B"]:
    """Return the continuous ranked probability score of a component [m]; 0 is perfect (Jordan et al. 2019, appendix A).

    Args:
        error, scale: of the component [m].
        freedom: degrees of freedom, above 1.
    """
    z = error / scale
    beta = special.beta(0.5, freedom - 0.5) / special.beta(0.5, freedom / 2) ** 2
    density, below = stats.t.pdf(z, freedom), stats.t.cdf(z, freedom)
    score = z * (2 * below - 1) + 2 * density * (freedom + z**2) / (freedom - 1)
    return np.asarray(scale * (score - 2 * math.sqrt(freedom) / (freedom - 1) * beta))


def area_under_curve(score: Float[np.ndarray, " N"], positive: Bool[np.ndarray, " N"]) -> float:
    """Return the probability that a positive scores higher than a negative; ties count half, NaN without both."""
    if positive.all() or not positive.any():
        return math.nan
    higher = stats.mannwhitneyu(score[positive], score[~positive], method="asymptotic").statistic
    return float(higher / (positive.sum() * (~positive).sum()))


@dataclass
class SpreadReport:
    """Calibration of predicted uncertainty.

    Attributes:
        rows: rows of the table.
        within: arrays of `calibration_rows` by the name of the run.
    """

    rows: list[CalibrationRow] = field(default_factory=list)
    within: dict[str, np.ndarray] = field(default_factory=dict)

    def add(self, name: str, run: Run, spread: Spread, dataset: Dataset) -> None:
        """Evaluate a run's spread on the windows of the test part that have a map."""
        windows = Windows(dataset, PART)
        index = windows.evaluation_indices(5)
        residuals = residuals_on_maps(run, windows, index)
        located = EvaluatedWindows(dataset, windows.drive[index], windows.row_in_drive(index))
        rows, self.within[name] = calibration_rows(name, spread, residuals, members(located), Sampling().on(located))
        self.rows += rows

    def write(self, out: Path) -> Path:
        """Write table, numbers and figure, log the table, and return the path of `calibration.md`."""
        table = calibration_table(self.rows)
        content = {"schema": 1, "part": PART, "rows": self.rows}
        with unfinished(out, UNFINISHED):
            write_png(out / "calibration.png", draw(calibration_chart(self.within)))
            write_text(out / "calibration.json", msgspec.json.encode(content).decode())
            write_text(out / "calibration.md", table.markdown() + "\n![calibration](calibration.png)\n")
        logger.info(table.text(width=150))
        logger.info(f"written: {out / 'calibration.md'}")
        return out / "calibration.md"


def calibrate(folders: Sequence[Path], path: Path, out: Path, settings: SpreadSettings | None = None) -> Path:
    """Fit the spread of each run that has none, and evaluate all on the windows of the test part that have a map.

    For runs that read features, a memory bank of training features is stored as well (`novelty`).

    Returns:
        path of `calibration.md`, next to `calibration.json` and `calibration.png`.

    Raises:
        RunError: a run does not fit the dataset, it or its spread was fitted to test data, or the spread belongs to
            other weights.
        DatasetError: a part has no window.
    """
    check_folder(out, own=REPORT_FILES)
    dataset, report = open_dataset(path), SpreadReport()
    runs = [_fitting_run(folder, dataset) for folder in folders]
    starting = [dataset.starting_above(_min_speed(run)) for run in runs]
    for each in starting:
        Windows(each, PART)  # raises before time is spent on a fit
    for run, name, mine in zip(runs, names_apart(folders), starting, strict=True):
        spread = kept_or_fitted(run, mine, settings)
        if run.dynamics.encoder is not None:
            keep_memory_bank(run, mine)
        report.add(name, run, spread, mine)
    return report.write(out)


def evaluate_kept_spreads(folders: Sequence[Path], path: Path, min_speed: float | None = None) -> SpreadReport | None:
    """Evaluate the spreads stored with runs, without fitting or writing.

    Args:
        min_speed: smallest speed at the start of a window [m/s]; None: as in the dataset.

    Returns:
        report to write; None if no run has a spread.

    Raises:
        RunError, DatasetError: as `calibrate`.
    """
    keeping = [folder for folder in folders if (run_folder(folder) / FILE).exists()]
    if not keeping:
        return None
    dataset, report = open_dataset(path).starting_above(min_speed), SpreadReport()
    for folder, name in zip(keeping, names_apart(keeping), strict=True):
        run = _fitting_run(folder, dataset)
        report.add(name, run, load_spread(run), dataset)
    return report


def _fitting_run(folder: Path, dataset: Dataset) -> Run:
    run = load_run(folder)
    refuse_unfit(run, dataset)
    refuse_seen(run, dataset, PART)
    kept = run.folder / FILE
    if not kept.exists():
        return run
    seen = msgspec.convert(load_tensors(kept)[1].get("seen", run.seen), list[Stretch])  # shipped files lack it
    if overlap := overlap_with(seen, dataset, PART):
        how = "delete it and run `offpiste calibrate` again, or evaluate it on other drives"
        raise RunError(f"was fitted to {overlap}", where=kept, how=how)
    return run


def kept_or_fitted(run: Run, dataset: Dataset, settings: SpreadSettings | None = None) -> Spread:
    """Read the spread in a run's folder; if there is none, fit and store it."""
    if (run.folder / FILE).exists():
        return load_spread(run)
    train, validation = Windows(dataset, "train"), Windows(dataset, "validation")
    spread = fit_spread(run, train, validation, settings)
    save_beside_weights(run.folder / FILE, spread.state_dict(), seen=seen_stretches(dataset))
    return spread


def _min_speed(run: Run) -> float | None:
    """Return the smallest speed at the start of the run's training windows; None: that of the dataset."""
    config = run.folder / "config.json"
    speed = load_json(config)["train"].get("min_speed") if config.exists() else None
    return None if speed is None else float(speed)
