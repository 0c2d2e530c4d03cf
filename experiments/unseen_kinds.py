"""How certain are models on ground that training never had? Each kind of ground is held out in turn.

All training and validation windows whose wheels touch that kind are left out. A model and its spread are trained on the
rest and evaluated on test windows that are mostly on the kind and on those that never touch it, beside the
reproduction's own model, which knows the kind. The PCA has seen it.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from experiments.command import run
from experiments.control_experiments.reproduced import open_reproduction
from experiments.control_experiments.runs import trained
from offpiste.core.conventions import HORIZON_STEPS
from offpiste.core.errors import DatasetError
from offpiste.core.files import write_text
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_windows import EvaluatedWindows
from offpiste.evaluation.intervals import Sampling
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.reproduction.results import MAP
from offpiste.reproduction.runs import evaluation_windows
from offpiste.reproduction.steps import claim_folder
from offpiste.simulation.world.ground import property_table
from offpiste.training.run import Run
from offpiste.uncertainty.calibration import (
    CalibrationRow,
    calibration_rows,
    calibration_table,
    kept_or_fitted,
)
from offpiste.uncertainty.fit import residuals_on_maps
from offpiste.uncertainty.spread import Spread

logger = logging.getLogger("experiments")

MOSTLY: Final = 0.5
"""Share of a window's steps and wheels on a kind from which the window counts as on it."""

FEWEST: Final = 50
"""Smallest number of windows on a kind that is held out."""

ELSEWHERE: Final = 300
"""Number of evaluated windows that never touch the kind, evenly spread."""

OUTSIDE: Final = -1
"""Label of rows without a part."""


@dataclass(frozen=True)
class UnseenKinds:
    """Hold each kind of ground out of training, and check how far predictions on it stray."""

    reproduction: Path = Path("results")
    """Folder of a finished `offpiste reproduce fig4`."""
    out: Path = Path("unseen-kinds")
    """Folder of all outputs; runs in it are used again."""
    model: str = "dc"
    """Model of the reproduction that is trained anew."""
    kinds: tuple[str, ...] = ()
    """To hold out; default: all that enough test windows are on."""
    seed: int = 0
    """Seed of the runs."""

    def run(self) -> str:
        """Train without each kind, evaluate, and show the table.

        Raises:
            DatasetError: no kind has enough windows, or an unknown one is named.
        """
        of = open_reproduction(self.reproduction)
        claim_folder(self.out, {"reproduction": str(self.reproduction.resolve())})
        truth = of.true_ground(self.out / "truth")
        kinds = [kinds_under_wheels(drive) for drive in truth.drives]
        windows = Windows(of.dataset, "test")
        index = evaluation_windows(windows, MAP, of.size.stride)
        share = share_on_kinds(windows, index, kinds)
        knowing = of.runs(self.model)[self.seed]
        rows = list[CalibrationRow]()
        for kind in chosen_kinds(self.kinds, share >= MOSTLY):
            away = np.flatnonzero(share[:, kind] == 0)
            away = away[np.unique(np.linspace(0, len(away) - 1, min(len(away), ELSEWHERE)).astype(int))]
            chosen = {"on it": index[share[:, kind] >= MOSTLY], "never on it": index[away]}
            without, name = without_kind(of.dataset, kinds, kind), GROUND_KINDS[kind]
            config = of.member(self.model).config(of.size, self.seed, "cpu")
            held = trained(without, config, self.out / name / "runs")
            rows += rows_of(f"{name} held out", held, kept_or_fitted(held, without), windows, chosen)
            rows += rows_of(f"{name} known", knowing, kept_or_fitted(knowing, of.dataset), windows, chosen)
        table = calibration_table(rows)
        content = {"schema": 1, "about": __doc__, "rows": msgspec.to_builtins(rows)}
        write_text(self.out / "unseen_kinds.json", json.dumps(content, indent=1))
        write_text(self.out / "unseen_kinds.md", table.markdown())
        return f"{table.text(width=150)}\nwritten: {self.out / 'unseen_kinds.md'}"


def nearest_kinds(properties: Float[np.ndarray, "N 4"]) -> Int[np.ndarray, " N"]:
    """Return the number of the kind with the nearest properties at any wetness."""
    dry, wet = property_table()
    wetness = np.linspace(0, 1, 41)[:, None, None]
    kinds = (1 - wetness) * dry + wetness * wet
    scale = kinds.std(axis=(0, 1))
    nearest = cKDTree((kinds / scale).reshape(-1, len(scale))).query(properties / scale)[1]
    return np.asarray(nearest % len(dry))


def kinds_under_wheels(truth: StoredDrive) -> Int[np.ndarray, "N 4"]:
    """Return the number of the kind nearest to the ground under each wheel; -1 if no ground is known."""
    cells = truth.rows.cells
    assert cells is not None
    of_cell = nearest_kinds(np.asarray(cells.features[0], np.float64))
    return np.where(cells.index >= 0, of_cell[cells.index], -1)


def without_kind(dataset: Dataset, kinds: Sequence[Int[np.ndarray, "N 4"]], kind: int) -> Dataset:
    """Return the dataset without a part for rows of training and validation with a wheel on a kind of ground."""

    def held_out(drive: StoredDrive, on: np.ndarray) -> StoredDrive:
        touched = (on == kind).any(axis=1) & (drive.part != PARTS.index("test"))
        return replace(drive, part=np.where(touched, OUTSIDE, drive.part))

    return replace(dataset, drives=tuple(map(held_out, dataset.drives, kinds)))


def share_on_kinds(
    windows: Windows, index: Int[np.ndarray, " n"], kinds: Sequence[Int[np.ndarray, "N 4"]]
) -> Float[np.ndarray, "n K"]:
    """Return the share of the steps and wheels of windows on each kind of ground.

    Args:
        kinds: of each drive, in the order of the dataset.
    """
    every, start = np.arange(len(GROUND_KINDS)), windows.row_in_drive(index) + 1
    before = [np.pad((on[:, :, None] == every).sum(axis=1).cumsum(axis=0), ((1, 0), (0, 0))) for on in kinds]
    counted = [before[d][s + HORIZON_STEPS] - before[d][s] for d, s in zip(windows.drive[index], start, strict=True)]
    return np.asarray(counted) / (4 * HORIZON_STEPS)


def chosen_kinds(names: Sequence[str], mostly: Bool[np.ndarray, "n K"]) -> list[int]:
    """Return the numbers of the kinds to hold out: those named, or all with enough windows.

    Raises:
        DatasetError: a name is unknown, or too few windows are on these kinds.
    """
    if unknown := [name for name in names if name not in GROUND_KINDS]:
        raise DatasetError(f"no kind of ground is called '{unknown[0]}'", how=f"choose from {', '.join(GROUND_KINDS)}")
    found = mostly.sum(axis=0)
    for name, count in zip(GROUND_KINDS, found, strict=True):
        logger.info(f"{name}: {count} test windows are mostly on it")
    chosen = [k for k, name in enumerate(GROUND_KINDS) if found[k] >= FEWEST and (not names or name in names)]
    if not chosen:
        raise DatasetError(f"fewer than {FEWEST} test windows are on each of these kinds", how="name others as --kinds")
    return chosen


def rows_of(
    name: str, run: Run, spread: Spread, windows: Windows, chosen: Mapping[str, Int[np.ndarray, " n"]]
) -> list[CalibrationRow]:
    """Return the calibration of a spread on a run's predictions of some test windows.

    Args:
        windows: of the test part.
        chosen: indices of some of them, by name.
    """
    rows = list[CalibrationRow]()
    for which, index in chosen.items():
        if len(index):
            located = EvaluatedWindows(windows.dataset, windows.drive[index], windows.row_in_drive(index))
            residuals = residuals_on_maps(run, windows, index)
            found, _ = calibration_rows(name, spread, residuals, {}, Sampling().on(located))
            rows += [msgspec.structs.replace(row, windows=which) for row in found]
    return rows


if __name__ == "__main__":
    run(UnseenKinds)
