"""`offpiste calibrate`: spreads of runs and what is familiar to them, kept with them; spreads are evaluated."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_windows import EvaluatedWindows
from offpiste.evaluation.intervals import Sampling
from offpiste.evaluation.speed_bands import members
from offpiste.files import write_text
from offpiste.report.figure import write_png
from offpiste.training.checkpoint import load_json, save_tensors
from offpiste.training.fitness import refuse_seen, refuse_unfit
from offpiste.training.run import Run, load_run
from offpiste.uncertainty.calibration import (
    CalibrationRow,
    calibration_rows,
    calibration_table,
    draw_calibration,
    foretold_by,
)
from offpiste.uncertainty.fit import SpreadSettings, fit_spread, strayed_on_maps
from offpiste.uncertainty.novelty import keep_familiar
from offpiste.uncertainty.prediction import FILE, load_spread
from offpiste.uncertainty.spread import Spread

logger = logging.getLogger(__name__)

PART: Final = "test"
"""Part of the dataset that calibration is evaluated on."""


def calibrate(folders: Sequence[Path], path: Path, out: Path, settings: SpreadSettings | None = None) -> Path:
    """Fit the spread of each run that has none, and evaluate all on the windows of the test part that have a map.

    What ground is familiar to a run that reads features is kept as well (`novelty`).

    Returns:
        Path of the table, `calibration.md`; `calibration.json` and `calibration.png` stand beside it.

    Raises:
        RunError: a run does not fit the dataset, has seen what it would be tested on, or its spread belongs to other
            weights.
        DatasetError: a part has no window.
    """
    dataset, rows, within = open_dataset(path), list[CalibrationRow](), dict[str, np.ndarray]()
    for folder in folders:
        run = load_run(folder)
        refuse_unfit(run, dataset)
        refuse_seen(run, dataset, PART)
        mine = dataset.starting_above(_min_speed(run))
        windows = Windows(mine, PART)
        index = windows.evaluation_indices(5)
        spread = kept_or_fitted(run, mine, settings)
        if run.dynamics.encoder is not None:
            keep_familiar(run, mine)
        strayed = strayed_on_maps(run, windows, index)
        located = EvaluatedWindows(mine, windows.drive[index], windows.row_in_drive(index))
        foretold = foretold_by(spread, strayed)
        rows += calibration_rows(folder.name, foretold, members(located), Sampling().on(located))
        within[folder.name] = foretold.within
    table = calibration_table(rows)
    write_png(out / "calibration.png", draw_calibration(within), dpi=110)
    write_text(out / "calibration.json", msgspec.json.encode({"schema": 1, "part": PART, "rows": rows}).decode())
    write_text(out / "calibration.md", table.markdown() + "\n![calibration](calibration.png)\n")
    logger.info(table.text(width=150))
    logger.info(f"written: {out / 'calibration.md'}")
    return out / "calibration.md"


def kept_or_fitted(run: Run, dataset: Dataset, settings: SpreadSettings | None = None) -> Spread:
    """The spread that a run's folder keeps, or one that is fitted now and kept there."""
    if (run.folder / FILE).exists():
        return load_spread(run)
    train, validation = Windows(dataset, "train"), Windows(dataset, "validation")
    spread = fit_spread(run, train, validation, settings)
    weights = load_json(run.folder / "model.json")["weights_sha256"]
    save_tensors(run.folder / FILE, spread.state_dict(), weights_sha256=weights)
    return spread


def _min_speed(run: Run) -> float | None:
    """Speed above which the run's training windows start; None: the dataset's."""
    config = run.folder / "config.json"
    speed = load_json(config)["train"].get("min_speed") if config.exists() else None
    return None if speed is None else float(speed)
