"""`offpiste calibrate`: spreads of runs and memory banks of known ground, kept with them; spreads are evaluated."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from offpiste.core.errors import RunError
from offpiste.core.files import check_folder, unfinished, write_text
from offpiste.core.shipped import names_apart, run_folder
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_windows import EvaluatedWindows
from offpiste.evaluation.intervals import Sampling
from offpiste.evaluation.report import REPORT_FILES, UNFINISHED
from offpiste.evaluation.speed_bands import members
from offpiste.report.figure import write_png
from offpiste.training.checkpoint import load_json, save_beside_weights
from offpiste.training.fitness import overlap_with, refuse_seen, refuse_unfit, seen_stretches
from offpiste.training.run import Run, load_run
from offpiste.uncertainty.calibration import (
    CalibrationRow,
    calibration_rows,
    calibration_table,
    draw_calibration,
    errors_with_scales,
)
from offpiste.uncertainty.fit import SpreadSettings, fit_spread, residuals_on_maps
from offpiste.uncertainty.novelty import keep_memory_bank
from offpiste.uncertainty.prediction import FILE, load_spread, spread_seen
from offpiste.uncertainty.spread import Spread

logger = logging.getLogger(__name__)

PART: Final = "test"
"""Part of the dataset that calibration is evaluated on."""


@dataclass
class SpreadReport:
    """How far errors lie within the regions of spreads.

    Attributes:
        rows: of the table.
        within: by run, the regions that errors lie on.
    """

    rows: list[CalibrationRow] = field(default_factory=list)
    within: dict[str, np.ndarray] = field(default_factory=dict)

    def add(self, name: str, run: Run, spread: Spread, dataset: Dataset) -> None:
        """Evaluate a run's spread on the windows of the test part that have a map."""
        windows = Windows(dataset, PART)
        index = windows.evaluation_indices(5)
        errors = errors_with_scales(spread, residuals_on_maps(run, windows, index))
        located = EvaluatedWindows(dataset, windows.drive[index], windows.row_in_drive(index))
        self.rows += calibration_rows(name, errors, members(located), Sampling().on(located))
        self.within[name] = errors.within

    def write(self, out: Path) -> Path:
        """Write table, numbers and picture; show the table; returns the path of `calibration.md`."""
        table = calibration_table(self.rows)
        content = {"schema": 1, "part": PART, "rows": self.rows}
        with unfinished(out, UNFINISHED):
            write_png(out / "calibration.png", draw_calibration(self.within), dpi=110)
            write_text(out / "calibration.json", msgspec.json.encode(content).decode())
            write_text(out / "calibration.md", table.markdown() + "\n![calibration](calibration.png)\n")
        logger.info(table.text(width=150))
        logger.info(f"written: {out / 'calibration.md'}")
        return out / "calibration.md"


def calibrate(folders: Sequence[Path], path: Path, out: Path, settings: SpreadSettings | None = None) -> Path:
    """Fit the spread of each run that has none, and evaluate all on the windows of the test part that have a map.

    Of runs that read features, some of their training's are kept as well (`novelty`).

    Returns:
        Path of the table, `calibration.md`; `calibration.json` and `calibration.png` stand beside it.

    Raises:
        RunError: a run does not fit the dataset, it or its spread has seen what would be tested, or the spread belongs
            to other weights.
        DatasetError: a part has no window.
    """
    check_folder(out, own=REPORT_FILES)
    dataset, report = open_dataset(path), SpreadReport()
    runs = [_fitting_run(folder, dataset) for folder in folders]
    starting = [dataset.starting_above(_min_speed(run)) for run in runs]
    for each in starting:
        Windows(each, PART)  # refuses what cannot be evaluated before time is spent on a fit
    for run, name, mine in zip(runs, names_apart(folders), starting, strict=True):
        spread = kept_or_fitted(run, mine, settings)
        if run.dynamics.encoder is not None:
            keep_memory_bank(run, mine)
        report.add(name, run, spread, mine)
    return report.write(out)


def evaluate_kept_spreads(folders: Sequence[Path], path: Path, min_speed: float | None = None) -> SpreadReport | None:
    """Evaluate the spreads that runs keep, as `calibrate` does; nothing is fitted or written.

    Args:
        min_speed: windows start above it [m/s]; None: as the dataset says.

    Returns:
        What is to be written; None where no run keeps a spread.

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
    if kept.exists() and (overlap := overlap_with(spread_seen(run), dataset, PART)) is not None:
        what = f"was fitted to {overlap.seconds:.0f} s of the {PART} part of drive '{overlap.drive}'"
        how = "delete it and run `offpiste calibrate` again, or evaluate it on other drives"
        raise RunError(what, where=kept, how=how)
    return run


def kept_or_fitted(run: Run, dataset: Dataset, settings: SpreadSettings | None = None) -> Spread:
    """The spread that a run's folder keeps, or one that is fitted now and kept there."""
    if (run.folder / FILE).exists():
        return load_spread(run)
    train, validation = Windows(dataset, "train"), Windows(dataset, "validation")
    spread = fit_spread(run, train, validation, settings)
    save_beside_weights(run.folder / FILE, spread.state_dict(), seen=seen_stretches(dataset))
    return spread


def _min_speed(run: Run) -> float | None:
    """Speed above which the run's training windows start; None: the dataset's."""
    config = run.folder / "config.json"
    speed = load_json(config)["train"].get("min_speed") if config.exists() else None
    return None if speed is None else float(speed)
