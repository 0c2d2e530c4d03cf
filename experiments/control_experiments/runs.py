"""Training runs of control experiments: finished ones are reused, interrupted ones resumed."""

import json
import logging
from dataclasses import asdict, replace
from pathlib import Path

from offpiste.core.errors import RunError
from offpiste.dataset.store import Dataset
from offpiste.reproduction.runs import reuse_stages
from offpiste.training.checkpoint import load_json
from offpiste.training.config import TrainConfig, other_settings
from offpiste.training.run import Run, load_run
from offpiste.training.train import digest_of, train

logger = logging.getLogger("experiments")

ELSEWHERE = "give the same again, or choose another --out"


def trained_seeds(
    dataset: Dataset, config: TrainConfig, runs: Path, seeds: int, *, stages: Path | None = None
) -> list[Run]:
    """The runs of a configuration with seeds 0, 1, ...; see `trained`."""
    return [trained(dataset, replace(config, seed=seed), runs, stages=stages) for seed in range(seeds)]


def trained(dataset: Dataset, config: TrainConfig, runs: Path, *, stages: Path | None = None) -> Run:
    """The run of a configuration in `runs/MODEL-SEED`.

    Args:
        stages: runs of the same dataset whose actuators and bicycle serve here too; else those in `runs`.

    Raises:
        RunError: the run that is there has other settings, or another dataset.
    """
    folder = runs / f"{config.model}-{config.seed}"
    if (folder / "model.json").exists():
        _refuse_other(folder, dataset, config)
    else:
        reuse_stages(stages or runs, folder, config.seed)
        logger.info(f"training {folder.name}")
        train(dataset, config, folder, resume=(folder / "config.json").exists())
    return load_run(folder)


def _refuse_other(folder: Path, dataset: Dataset, config: TrainConfig) -> None:
    """Raise unless a finished run is of these settings and this dataset, wherever that lay then."""
    path = folder / "config.json"
    before = load_json(path) if path.exists() else {}
    wanted = json.loads(json.dumps({"train": asdict(config), "split": dataset.split.text}))
    if dataset.split.kind == "drives":  # its text is a path; the parts of drives are in the digest
        del wanted["split"]
    if other := other_settings(before, {key: value for key, value in wanted.items() if key in before}):
        raise RunError(f"holds a run of other settings ({other})", where=folder, how=ELSEWHERE)
    if "dataset_sha256" not in before:
        logger.warning(f"{folder}: does not say what data it is of, since an older offpiste trained it: it is reused")
    elif before["dataset_sha256"] != digest_of(dataset):
        raise RunError("holds a run of another dataset, or of this one before it changed", where=folder, how=ELSEWHERE)
