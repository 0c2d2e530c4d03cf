"""Ablated models beside `b` and `dc`: looking ahead, physics, parameters, history and drawn feature sets.

A finished run of the same settings and data is reused, an interrupted one resumed.
"""

import json
import logging
from dataclasses import asdict, replace
from pathlib import Path

from experiments.control_experiments.data import ELSEWHERE
from experiments.control_experiments.reproduced import Reproduced
from experiments.control_experiments.tables import write_control
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.errors import RunError
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.evaluated_models import Reading
from offpiste.reproduction.gains import HINDSIGHT, MAP, errors_of, evaluation_index, gain, gain_table
from offpiste.reproduction.runs import reuse_stages
from offpiste.training.checkpoint import load_json
from offpiste.training.config import TrainConfig, other_settings
from offpiste.training.run import Run, load_run
from offpiste.training.train import digest_of, train

logger = logging.getLogger("experiments")

FEATURED = {
    "dc-hold": "dc with the features of the window's start held: what looking ahead adds",
    "dc-step": "a set drawn at every step, not once a trajectory",
    "cf-masked": "hindsight, masked as a drawn distance would be: does distance matter, or only what is missing",
}
BLIND = {
    "lstm": "no physics",
    "b-wide": "b with as many parameters as dc",
    "b-history": "b with a stronger reading of the last 0.2 s",
}
ABOUT = (
    "Relative to the baseline on the same windows, with 95 % intervals. Map: as it was at the window's start, read at "
    "predicted places. "
)


def models_control(of: Reproduced, out: Path, models: list[str], seeds: int) -> Path:
    """Train each ablated model like the reproduction's own, and evaluate all on its windows.

    Args:
        models: of `FEATURED` and `BLIND`; all where empty.
        seeds: runs of each ablated model.
    """
    chosen = models or [*FEATURED, *BLIND]
    windows = Windows(of.dataset, "test")
    folder, scale = out / "models", of.scale
    present = of.present(("b", "cf", "dc"))
    runs = {model: of.runs(model) for model in present}
    for model in chosen:
        config = of.member(model).config(of.size, 0, "cpu")
        runs[model] = trained_seeds(of.dataset, config, folder / "runs", seeds, stages=of.folder / "runs")
    readings: list[Reading] = [MAP, HINDSIGHT] + [("recorded", name) for name in ("10", "20", "30", "40")]
    errors: dict[tuple[str, Reading], list[Errors]] = {}
    for reading in readings:
        index = evaluation_index(windows, reading, of.size.stride)
        for model in runs:
            if reading in (MAP, HINDSIGHT) or model not in BLIND:
                errors[model, reading] = [
                    errors_of(run, windows, index, reading, scale=scale, kept=out / "evaluated") for run in runs[model]
                ]
    over_b = [
        gain(FEATURED.get(model, BLIND.get(model, "")), model, result, errors["b", reading], reading)
        for (model, reading), result in errors.items()
        if model != "b"
    ]
    over_dc = [
        gain("", model, result, errors["dc", reading], reading, baseline="dc")
        for (model, reading), result in errors.items()
        if "dc" in runs and model not in ("b", "cf", "dc")
    ]
    tables = [gain_table("Control models against b", over_b, ABOUT + "Baseline: b.")]
    if over_dc:
        tables.append(gain_table("Control models against dc", over_dc, ABOUT + "Baseline: dc; above 0: worse."))
    return write_control(folder, tables, {"control": "models", "against_b": over_b, "against_dc": over_dc})


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
