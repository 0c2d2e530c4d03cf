"""Is ground recognised that no training drive had? Each kind of ground is held out in turn.

A dataset of simulated drives with visual features, and another of the same drives with the true ground properties
(`reproduce` makes both). Cells under the wheels of its training part fill the memory bank, without those of one kind,
and validation's, without them too, set the limit; in the test part the distance from the bank is to tell that kind from
all others. The PCA may have seen the kind; the bank has not.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from experiments.command import run
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import DatasetError
from offpiste.core.files import write_text
from offpiste.core.progress import track
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, StoredDrive, open_dataset
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES
from offpiste.report.text_table import TextTable, number
from offpiste.simulation.world.ground import property_table
from offpiste.uncertainty.calibration import area_under_curve
from offpiste.uncertainty.novelty import NoveltySettings, fit_memory_bank

PURE: Final = 0.05
"""Largest distance of a cell's properties from those of its kind, in standard deviations between kinds; cells further
away are mixtures, and belong to none."""

AT_ONCE: Final = 10_000
"""Cells that are compared with all kinds at once."""

FEWEST: Final = 100
"""Cells of a kind in the test part, for a row of the table."""

ABOUT: Final = (
    "Area: probability that a cell of the kind that was held out is further from those of training than a cell of a "
    "known kind (0.5 is chance). Novel: share of cells of that kind, and of known kinds, beyond the limit."
)


@dataclass(frozen=True)
class SeenCells:
    """Cells as they were seen: features, number of the kind (-1 for a mixture), number of the feature set."""

    features: torch.Tensor
    kind: Int[np.ndarray, " N"]
    seen_from: Int[np.ndarray, " N"]

    def where(self, mine: Bool[np.ndarray, " N"]) -> torch.Tensor:
        """Features of some of them."""
        return self.features[torch.from_numpy(mine)]


@dataclass(frozen=True)
class HeldOut:
    """Recognise ground of a kind that no training drive had."""

    dataset: Path
    """Dataset of simulated drives, with visual features."""
    truth: Path
    """Dataset of the same drives, with `--features ground-truth`."""
    out: Path = Path("novelty")
    """Folder of all outputs."""
    sets: tuple[str, ...] = ("hindsight", "10", "20")
    """Feature sets that are read: by the distance cells were seen from [m]."""
    cells: int = 400
    """Cells of each drive and feature set, drawn at random."""
    powers: tuple[float, ...] = (0.0, 0.5, 1.0)
    """Powers of the features' standard deviation that they are divided by."""
    seed: int = 0
    """Seed by which cells are drawn."""

    def run(self) -> str:
        """Read the cells, hold out each kind, write and show the table.

        Raises:
            DatasetError: the second is no truth of the first.
        """
        dataset, truth = open_dataset(self.dataset), open_dataset(self.truth)
        refuse_unlike(dataset, truth)
        seen = {part: self.seen(dataset, truth, part) for part in PARTS}
        rows = [row for power in self.powers for row in held_out_rows(seen, NoveltySettings(power=power))]
        write_text(self.out / "novelty.json", json.dumps({"schema": 1, "rows": rows}, indent=1))
        table = novelty_table(rows)
        write_text(self.out / "novelty.md", table.markdown())
        return f"{table.text(width=120)}\nwritten: {self.out / 'novelty.md'}"

    def seen(self, dataset: Dataset, truth: Dataset, part: str) -> SeenCells:
        """Cells of the drives of a part."""
        rng, found = np.random.default_rng(self.seed), list[SeenCells]()
        for drive, true in track(list(zip(dataset.drives, truth.drives, strict=True)), f"reading {part}"):
            if (drive.part == PARTS.index(part)).any():
                found += [seen_cells(drive, true, FEATURE_SETS.index(name), self.cells, rng) for name in self.sets]
        return SeenCells(
            torch.cat([each.features for each in found]),
            np.concatenate([each.kind for each in found]),
            np.concatenate([each.seen_from for each in found]),
        )


def refuse_unlike(dataset: Dataset, truth: Dataset) -> None:
    """Raise unless one dataset has the true ground of another's drives."""
    if truth.features != GROUND_PROPERTIES:
        raise DatasetError("has no true ground", where=truth.path, how="extract it with `--features ground-truth`")
    pairs = zip(dataset.drives, truth.drives, strict=False)
    alike = len(dataset.drives) == len(truth.drives)
    if not alike or any(a.name != b.name or not np.array_equal(a.rows.time, b.rows.time) for a, b in pairs):
        raise DatasetError(f"has other drives than {dataset.path}", where=truth.path, how="extract both of one folder")


def seen_cells(drive: StoredDrive, true: StoredDrive, seen_from: int, most: int, rng: np.random.Generator) -> SeenCells:
    """Some valid cells of a drive in one feature set, with the kind of ground that its wheels then were on."""
    cells, ground = _cells(drive), _cells(true)
    touched, first = np.unique(cells.index, return_index=True)
    there = ground.index.reshape(-1)[first]
    usable = (touched >= 0) & (there >= 0)
    touched, there = touched[usable], there[usable]
    keep = cells.valid[seen_from, touched]
    touched, there = touched[keep], there[keep]
    chosen = np.sort(rng.permutation(len(touched))[:most])
    features = np.asarray(cells.features[seen_from, touched[chosen]], np.float32)
    kind = kinds_of(np.asarray(ground.features[0, there[chosen]], np.float64))
    return SeenCells(torch.from_numpy(features), kind, np.full(len(chosen), seen_from))


def _cells(drive: StoredDrive) -> Cells:
    if drive.rows.cells is None:
        raise DatasetError(f"drive '{drive.name}' has no features", how="extract it with --pca")
    return drive.rows.cells


@cache
def _of_kinds() -> Float[np.ndarray, "W K 4"]:
    """Properties of the kinds from dry to wet."""
    dry, wet = property_table()
    wetness = np.linspace(0, 1, 41)[:, None, None]
    return np.asarray((1 - wetness) * dry + wetness * wet)


def kinds_of(properties: Float[np.ndarray, "N 4"]) -> Int[np.ndarray, " N"]:
    """Number of the kind with these properties, however wet; -1 where none has them."""
    apart = _distances(properties)
    return np.where(apart.min(axis=1) < PURE, apart.argmin(axis=1), -1)


def nearest_kinds(properties: Float[np.ndarray, "N 4"]) -> Int[np.ndarray, " N"]:
    """Number of the kind whose properties are nearest, however wet: of a mixture, about that of the larger part."""
    parts = np.array_split(properties, len(properties) // AT_ONCE + 1)
    return np.concatenate([_distances(part).argmin(axis=1) for part in parts])


def _distances(properties: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N K"]:
    kinds = _of_kinds()
    apart = (properties[:, None, None] - kinds) / kinds.std(axis=(0, 1))
    return np.asarray(np.linalg.norm(apart, axis=-1).min(axis=1))


def held_out_rows(seen: dict[str, SeenCells], settings: NoveltySettings) -> list[dict[str, Any]]:
    """A row for each kind of ground that the test part has enough of and each feature set, the kind held out."""
    rows, test = list[dict[str, Any]](), seen["test"]
    for held, kind in enumerate(GROUND_KINDS):
        training, validation = (
            seen[part].where((seen[part].kind != held) & (seen[part].kind >= 0)) for part in PARTS[:2]
        )
        bank = fit_memory_bank(training, validation, settings)
        for seen_from in np.unique(test.seen_from):
            compared = (test.kind >= 0) & (test.seen_from == seen_from)
            positive = test.kind[compared] == held
            if positive.sum() < FEWEST:
                continue
            distance = bank.distance(test.where(compared)).numpy()
            novel = distance > float(bank.limit)
            rows.append(
                {
                    "kind": kind,
                    "set": FEATURE_SETS[seen_from],
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
