"""Runs that controls need beside those of a reproduction; a finished one is used again, an interrupted one goes on."""

from collections.abc import Callable
from pathlib import Path

from offpiste.dataset.store import Dataset
from offpiste.experiments.shared_stages import reuse_stages
from offpiste.training.config import TrainConfig
from offpiste.training.run import Run, load_run
from offpiste.training.train import train


def trained(
    dataset: Dataset, config: TrainConfig, runs: Path, *, tell: Callable[[str], None], stages: Path | None = None
) -> Run:
    """The run of a configuration in `runs/MODEL-SEED`.

    Args:
        stages: runs of the same dataset whose actuators and bicycle serve here too; else those in `runs`.
    """
    folder = runs / f"{config.model}-{config.seed}"
    if not (folder / "model.json").exists():
        reuse_stages(stages or runs, folder, config.seed)
        tell(f"training {folder.name}")
        train(dataset, config, folder, resume=(folder / "config.json").exists())
    return load_run(folder)
