"""Do visual features know the friction? Linear probes to the true friction, by viewing distance.

Drives of some seeds train the probe (and the PCA), drives of others test it, each in a world of its own. Its ceiling is
the true ground kind, its floor brightness.
"""

import json
import logging
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from experiments.arrays import load_arrays, save_arrays
from experiments.command import run
from experiments.probe.cells import SeenCells, see_cells
from experiments.probe.scores import Pooled, pool, probe_rows
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import PerceptionError
from offpiste.core.files import write_text
from offpiste.core.progress import track
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.splits import parse_split
from offpiste.perception.backbones import open_backbone
from offpiste.perception.backbones.filterbank import FILTERBANK
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.perception.pca import save_pca
from offpiste.rig.rig import Rig, load_rig
from offpiste.simulation.simulate import DriveSettings, simulate_once
from offpiste.simulation.world.world import WorldSettings

logger = logging.getLogger("experiments")

MIXED = "mixed"
"""All worlds together."""


@dataclass(frozen=True)
class Probe:
    """Do visual features know the friction? Simulates, fits the PCA and probes; resumes where it stopped."""

    out: Path = Path("probe")
    """Folder of all outputs."""
    drives: Path | None = None
    """Folder of drives called WORLD-SEED.mcap; missing ones are simulated. OUT/drives by default."""
    worlds: tuple[str, ...] = ("mojave", "halter-ranch", "coastal-scrub", "dunes")
    """Worlds of the drives."""
    seconds: float = 120.0
    """Duration of each simulated drive [s]."""
    seeds: tuple[int, ...] = (61,)
    """Seeds of the training drives."""
    test_seeds: tuple[int, ...] = (62,)
    """Seeds of the test drives."""
    backbone: str = FILTERBANK
    """Backbone whose features are probed."""
    images: int = 175
    """Number of images that the PCA is fitted on."""

    def run(self) -> None:
        """Run the whole experiment."""
        if both := set(self.seeds) & set(self.test_seeds):
            raise PerceptionError(f"seed {min(both)} is in training and test", how="give other --test-seeds")
        rows = self.by_distance()
        made = {"numpy": np.__version__, "python": platform.python_version(), "pca": self.extractor.identity}
        result = {"settings": json.loads(json.dumps(asdict(self), default=str)), "made_with": made}
        write_text(self.out / "probe.json", json.dumps(result | {"probes": rows}, indent=1))
        logger.info(str(self.out / "probe.json"))

    def by_distance(self) -> list[dict[str, Any]]:
        """Return the probes of each world, and of all together."""
        groups: dict[str, tuple[str, ...]] = {world: (world,) for world in self.worlds}
        if len(self.worlds) > 1:
            groups[MIXED] = self.worlds
        rows: list[dict[str, Any]] = []
        for name, worlds in groups.items():
            train, test = self.pooled(worlds, self.seeds), self.pooled(worlds, self.test_seeds)
            rows += probe_rows(train, test, name)
            logger.info(distance_table([row for row in rows if row["worlds"] == name], name))
        return rows

    def pooled(self, worlds: Sequence[str], seeds: Sequence[int]) -> Pooled:
        """Return the cells of drives, extracted once."""
        names = [(world, seed) for world in worlds for seed in seeds]
        folder = self.out / "cells" / self.extractor.identity
        cells = []
        for world, seed in track(names, "extract"):
            log, path = self.log(world, seed), folder / f"{world}-{seed}.npz"
            if not path.exists():
                save_arrays(see_cells(log, self.rig, self.extractor), path)
            cells.append(load_arrays(SeenCells, path))
        return pool(cells)

    def log(self, world: str, seed: int) -> Path:
        """Return the log of a drive, simulated once."""
        path = (self.drives or self.out / "drives") / f"{world}-{seed}.mcap"
        settings = DriveSettings(WorldSettings(world, seed), self.seconds, seed=seed, sensors="light")
        logger.info(simulate_once(settings, path))
        return path

    @cached_property
    def rig(self) -> Rig:
        """Rig of the proving ground."""
        return load_rig("proving_ground")

    @cached_property
    def extractor(self) -> FeatureExtractor:
        """Backbone and PCA; the PCA is fitted once, on the drives that train.

        Raises:
            PerceptionError: the existing PCA was fitted on a test drive.
        """
        path = self.out / "pca.safetensors"
        if not path.exists():
            logs = [self.log(world, seed) for world in self.worlds for seed in self.seeds]
            backbone = open_backbone(self.backbone)
            fitted = fit_pca(logs, self.rig, parse_split("blocks:1,0,0"), backbone, images=self.images)
            save_pca(path, fitted.pca)
        extractor = load_feature_extractor(path)
        test_logs = {f"{world}-{seed}" for world in self.worlds for seed in self.test_seeds}
        if both := test_logs & set(extractor.pca.fitted_on.get("logs", ())):
            raise PerceptionError(f"fitted on '{min(both)}', a test drive", where=path, how="give another --out")
        return extractor


def distance_table(rows: Sequence[dict[str, Any]], title: str) -> Table:
    """Return R² by input and feature set."""
    table = Table("target", "trained on", "from", *FEATURE_SETS, title=f"{title}: R²")
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        key = tuple(row[name] for name in ("target", "trained", "input"))
        lines.setdefault(key, {})[row["feature_set"]] = f"{row['r2']:.2f}"
    for key, result in lines.items():
        table.add_row(*key, *(result.get(name, "") for name in FEATURE_SETS))
    return table


if __name__ == "__main__":
    run(Probe)
