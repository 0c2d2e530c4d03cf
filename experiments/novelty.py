"""Is ground recognised that no training drive had? Each kind of ground is held out in turn.

Cells under the wheels of simulated drives (`experiments.probe`), as they looked from each distance, with their true
kind. Drives of some seeds say what is familiar, without the cells of one kind; on drives of other seeds the distance
from the familiar is to tell that kind from all others. The PCA may have seen the kind; the looks have not.
"""

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Bool, Int

from experiments.command import run
from experiments.probe.cells import SeenCells, see_cells_once
from offpiste.conventions import FEATURE_SETS
from offpiste.errors import PerceptionError
from offpiste.files import write_text
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.progress import track
from offpiste.report.text_table import TextTable, number
from offpiste.rig.rig import load_rig
from offpiste.uncertainty.novelty import NoveltySettings, fit_familiar
from offpiste.uncertainty.student import area_under_curve

logger = logging.getLogger("experiments")

PURE: Final = 0.7
"""Share of a cell that its kind covers at least; others belong to none."""

FEWEST: Final = 30
"""Cells of a kind in the test drives, for a row of the table."""

VALIDATED: Final = 5
"""Every fifth stretch of `STRETCH` rows of the training drives sets the limit."""

STRETCH: Final = 250
"""Rows of a stretch: 5 s."""

ABOUT: Final = (
    "Area: probability that a cell of the kind that was held out is further from the familiar looks than a cell of a "
    "known kind (0.5 is chance). Novel: share of cells of that kind, and of known kinds, beyond the limit."
)


@dataclass(frozen=True)
class Looks:
    """Valid cells as they looked from one distance: features, number of the kind (-1 for none), row of the drive."""

    features: torch.Tensor
    kind: Int[np.ndarray, " N"]
    row: Int[np.ndarray, " N"]

    def where(self, mine: Bool[np.ndarray, " N"]) -> "Looks":
        """Some of them."""
        return Looks(self.features[torch.from_numpy(mine)], self.kind[mine], self.row[mine])


@dataclass(frozen=True)
class HeldOut:
    """Is ground of a kind that no training drive had recognised? Resumes where it stopped."""

    train_logs: tuple[Path, ...]
    """Simulated drives that say what is familiar."""
    test_logs: tuple[Path, ...]
    """Drives in other worlds."""
    pca: Path
    """Of the features."""
    out: Path = Path("novelty")
    """Folder of all outputs."""
    seconds: float | None = None
    """Of each drive, from its start; all by default."""
    powers: tuple[float, ...] = (0.0, 0.5, 1.0)
    """Of the features' standard deviation that they are divided by."""

    def run(self) -> str:
        """See the cells, hold out each kind, write and show the table.

        Raises:
            PerceptionError: a drive is in training and test.
        """
        if both := {path.resolve() for path in self.train_logs} & {path.resolve() for path in self.test_logs}:
            raise PerceptionError("is in training and test", where=min(both), how="give other --test-logs")
        rows = [
            row
            for name in FEATURE_SETS
            for power in self.powers
            for row in held_out_rows(
                self.looks(self.train_logs, name), self.looks(self.test_logs, name), name, NoveltySettings(power=power)
            )
        ]
        write_text(self.out / "novelty.json", json.dumps({"schema": 1, "rows": rows}, indent=1))
        table = novelty_table(rows)
        write_text(self.out / "novelty.md", table.markdown())
        return f"{table.text(width=120)}\nwritten: {self.out / 'novelty.md'}"

    def looks(self, logs: Sequence[Path], name: str) -> Looks:
        """Cells of drives in one feature set; rows of drives lie far apart."""
        each = [looks_in(self.cells[log], FEATURE_SETS.index(name)) for log in logs]
        far = [replace(looks, row=looks.row + (1 << 24) * place) for place, looks in enumerate(each)]
        return Looks(
            torch.cat([looks.features for looks in far]),
            np.concatenate([looks.kind for looks in far]),
            np.concatenate([looks.row for looks in far]),
        )

    @cached_property
    def cells(self) -> dict[Path, SeenCells]:
        """Of all drives."""
        rig, found = load_rig("proving_ground"), {}
        for log in track((*self.train_logs, *self.test_logs), "extract"):
            length = "" if self.seconds is None else f"-{self.seconds:g}s"
            piece = self.out / "cells" / self.extractor.identity / f"{log.stem}{length}.npz"
            found[log] = see_cells_once(piece, log, rig, self.extractor, seconds=self.seconds)
        return found

    @cached_property
    def extractor(self) -> FeatureExtractor:
        """Backbone and PCA."""
        return load_feature_extractor(self.pca)


def looks_in(cells: SeenCells, feature_set: int) -> Looks:
    """Valid cells of one feature set, with the kind that covers most of them."""
    shares = cells.ground[:, : len(GROUND_KINDS)]
    kind = np.where(shares.max(axis=1) >= PURE, shares.argmax(axis=1), -1)
    valid = cells.valid[feature_set]
    features = torch.from_numpy(cells.features[feature_set][valid].astype(np.float32))
    return Looks(features, kind[valid], cells.row[valid])


def held_out_rows(train: Looks, test: Looks, name: str, settings: NoveltySettings) -> list[dict[str, Any]]:
    """A row for each kind of ground that both parts have enough of, held out of training.

    Args:
        name: of the feature set.
    """
    rows = []
    validates = train.row // STRETCH % VALIDATED == 0
    for place, kind in enumerate(GROUND_KINDS):
        seen, there = train.kind != place, test.kind == place
        if there.sum() < FEWEST or (train.kind == place).sum() < FEWEST:
            continue
        known = train.where(seen & ~validates).features, train.where(seen & validates).features
        familiar = fit_familiar(*known, settings)
        compared = test.where(test.kind >= 0)
        positive, distance = compared.kind == place, familiar.distance(compared.features).numpy()
        novel = distance > float(familiar.limit)
        rows.append(
            {
                "kind": kind,
                "set": name,
                "power": settings.power,
                "n": int(positive.sum()),
                "area": area_under_curve(distance, positive),
                "novel": float(novel[positive].mean()),
                "false": float(novel[~positive].mean()),
            }
        )
    return rows


def novelty_table(rows: Sequence[dict[str, Any]]) -> TextTable:
    """A line a kind, feature set and power."""
    names = ("held out", "seen from", "power", "cells", "area", "novel [%]", "known ones [%]")
    lines = [
        (
            row["kind"],
            row["set"],
            f"{row['power']:g}",
            f"{row['n']}",
            number(row["area"]),
            number(100 * row["novel"], 0),
            number(100 * row["false"], 0),
        )
        for row in rows
    ]
    return TextTable("Novel ground", names, tuple(lines), ABOUT, left=2)


if __name__ == "__main__":
    run(HeldOut)
