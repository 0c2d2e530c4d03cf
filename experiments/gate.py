"""Gate before any camera: how much knowing the true ground ahead reduces the prediction error.

Simulated drives without sensors; features are the true ground under each wheel, read at predicted places. `df` knows
the ground along its path, `hold` only that of the start, `b` nothing; `b-history` has more units for the last 0.2 s.
"""

import json
import logging
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from experiments.command import run
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.splits import write_drives
from offpiste.evaluation.evaluate_runs import evaluate_runs
from offpiste.reproduction.runs import reuse_stages
from offpiste.rig.rig import load_rig
from offpiste.simulation.recordings import simulate_once
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world.world import WorldSettings
from offpiste.training.config import TrainConfig
from offpiste.training.train import train

logger = logging.getLogger("experiments")


@dataclass(frozen=True)
class Gate:
    """How much the true ground ahead reduces the prediction error; resumes where it stopped."""

    out: Path = Path("gate")
    """Folder of all outputs."""
    world: str = "mojave"
    """World; on `uniform` the features are a placebo."""
    contrast: float = 1.0
    """Grip contrast of the worlds."""
    features: Literal["ground-truth", "ground-kind"] = "ground-truth"
    """Features of the oracle; on `uniform` only kinds differ."""
    drives: tuple[int, int, int] = (12, 3, 6)
    """Number of drives to train, validate and test on, each in a world of its own."""
    same_world: bool = False
    """Simulate all drives in one world, so that training and test share the ground."""
    seconds: float = 120.0
    """Duration of each drive [s]."""
    models: tuple[str, ...] = ("df", "hold", "b", "parametric", "b-history")
    """Models to compare."""
    seeds: int = 3
    """Runs of each model (`parametric`: one)."""
    train: TrainConfig = field(default_factory=lambda: TrainConfig(epochs=15, bicycle_epochs=15, batch=256))
    """Settings of all trainings."""

    def run(self) -> None:
        """Run the whole experiment."""
        drives = self.simulate()
        dataset = make_dataset(
            [path for path, _ in drives],
            load_rig("proving_ground"),
            self.out / "dataset.zarr",
            split=write_drives(self.out / "parts.txt", ((path.stem, part) for path, part in drives)),
            features=self.features,
            force=True,
        )
        runs = []
        for model in self.models:
            for seed in range(1 if model == "parametric" else self.seeds):
                folder = self.out / "runs" / f"{model}-{seed}"
                if not (folder / "model.json").exists():
                    config = replace(self.train, model=model, seed=seed)
                    reuse_stages(self.out / "runs", folder, seed)
                    train(dataset, config, folder, resume=(folder / "config.json").exists())
                runs.append(folder)
        evaluate_runs(runs, dataset.path, self.out / "report", starts=("causal",))
        logger.info(verdict(json.loads((self.out / "report" / "metrics.json").read_text("utf-8"))))

    def simulate(self) -> list[tuple[Path, str]]:
        """Simulated logs and their parts of the dataset."""
        logs = []
        for number, part in enumerate(
            p for p, n in zip(("train", "validation", "test"), self.drives, strict=True) for _ in range(n)
        ):
            path = self.out / "logs" / f"{self.world}-{number}.mcap"
            world = WorldSettings(self.world, 1000 if self.same_world else 1000 + number, self.contrast)
            logger.info(simulate_once(DriveSettings(world, self.seconds, seed=number, sensors="none"), path))
            logs.append((path, part))
        return logs


def verdict(metrics: dict[str, Any]) -> str:
    """Mean 5 s error and loss of each model on the map from the causal start, and `df` against the others."""
    rows = {
        row["model"]: row
        for row in reversed(metrics["results"])  # the row over all seeds comes first
        if row["start"] == "causal" and row["lookup"] in ("map", None) and row["horizon_s"] == 5.0
    }
    lines = ["model         5 s error [m]          loss    df against it: position            loss"]
    for name, row in rows.items():
        error, loss = row["distance_error_m"], row["loss"]
        line = f"{name:12} {error['mean']:6.2f} [{error['ci95'][0]:.2f}, {error['ci95'][1]:.2f}] {loss['mean']:8.3f}"
        minus = rows["df"]["minus"].get(name) if "df" in rows else None
        if minus:
            for key, own in (("distance_error_m", error), ("loss", loss)):
                low, high = (100 * bound / own["mean"] for bound in minus[key]["ci95"])
                line += f"   {100 * minus[key]['mean'] / own['mean']:+.0f} % [{low:+.0f}, {high:+.0f}]"
        lines.append(line)
    return "\n".join(lines)


if __name__ == "__main__":
    run(Gate)
