"""Training and evaluation steps of a figure's models: one per run, one per terrain lookup."""

from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import torch

from offpiste.core.checksums import CHECKSUMS
from offpiste.core.conventions import DT
from offpiste.core.files import write_bytes
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, errors_of_models, save_errors
from offpiste.evaluation.evaluate import Reading
from offpiste.reproduction.data import open_checked, opened
from offpiste.reproduction.settings import BASELINE, FigureModel, ReproductionSettings
from offpiste.reproduction.steps import Step
from offpiste.training.checkpoint import SHARED_STAGES
from offpiste.training.distributed import ALONE
from offpiste.training.losses import MapLoss, map_loss
from offpiste.training.run import Run, best_epochs, load_run, refuse_seen
from offpiste.training.train import train

PART = "test"
"""Evaluated part of the split."""

WINDOW_SECONDS, READING = 0.5e-3, 1.8
"""Estimated time of the kernels per window [s], and a factor for models that read features."""

MAP_SECONDS = 0.02
"""Estimated time to read a window's own map [s]."""


def reuse_stages(runs: Path, folder: Path, seed: int) -> None:
    """Copy stages fitted by another run of the same seed; folders are named NAME-SEED.

    Args:
        runs: folder of all runs, which share the dataset and the settings of these stages.
        folder: of the run.
    """
    for stage in SHARED_STAGES:
        name = f"{stage}.safetensors"
        done = sorted(runs.glob(f"*-{seed}/{name}"))
        if done and not (folder / name).exists():
            write_bytes(folder / name, done[0].read_bytes())


def errors_path(run: Path, reading: Reading) -> Path:
    """Return the path of a run's errors, in its folder so that they move with it."""
    return run / "errors" / f"{'-'.join(filter(None, reading))}.safetensors"


def evaluation_windows(windows: Windows, reading: Reading, stride: int) -> np.ndarray:
    """Return the indices of the windows to evaluate: a stride apart, or those with a snapshot of the map."""
    return windows.evaluation_indices(stride) if reading[0] == "map" else windows.strided(stride)


def errors_of_runs(
    runs: Sequence[Run], windows: Windows, index: np.ndarray, reading: Reading, *, scale: torch.Tensor
) -> list[Errors]:
    """Compute the errors of runs with one terrain lookup; windows and maps are read once.

    Args:
        scale: units of the loss, the same for all runs.
    """
    lookup, chosen = reading
    return errors_of_models(
        [(run.dynamics, torch.tensor(run.weights.in_order())) for run in runs],
        windows.with_feature_set(chosen) if chosen else windows,
        index,
        lookup=lookup,
        scale=scale,
        description=f"evaluating {', '.join(run.folder.name for run in runs)}",
    )


def loss_units(settings: ReproductionSettings) -> torch.Tensor:
    """Return the units of the loss of the first `b`, used for all runs."""
    return load_run(settings.runs / f"{BASELINE}-0").scale


@lru_cache(maxsize=1)
def _with_maps(settings: ReproductionSettings, start: str, version: tuple[int, ...]) -> tuple[Dataset, MapLoss | None]:
    """Open the dataset and the maps of its validation windows; cached, by a version that changes with the dataset."""
    dataset = open_checked(settings)
    return dataset, map_loss(Windows(dataset, "validation", start=start), ALONE)


def train_run(settings: ReproductionSettings, model: FigureModel, seed: int) -> None:
    """Train a run, or resume its training."""
    folder = settings.runs / model.folder(seed)
    reuse_stages(settings.runs, folder, seed)
    config = model.config(settings.size, seed, settings.device)
    version = tuple(path.stat().st_mtime_ns for path in sorted(settings.data.glob(f"*/{CHECKSUMS}")))
    dataset, maps = _with_maps(settings, config.start, version)
    train(dataset, config, folder, resume=(folder / "config.json").exists(), maps=maps)


def evaluate_all(settings: ReproductionSettings, runs: Sequence[Path], reading: Reading) -> None:
    """Compute and save the missing errors of runs with one terrain lookup."""
    dataset = opened(settings)
    loaded = [load_run(each, device=settings.device) for each in runs if not errors_path(each, reading).exists()]
    for run in loaded:
        refuse_seen(run, dataset, PART)
    windows = Windows(dataset, PART, start="causal", device=settings.device)
    index = evaluation_windows(windows, reading, settings.size.stride)
    found = errors_of_runs(loaded, windows, index, reading, scale=loss_units(settings))
    for run, errors in zip(loaded, found, strict=True):
        save_errors(errors_path(run.folder, reading), errors)


def model_stages(
    settings: ReproductionSettings,
    models: Sequence[FigureModel],
    readings: Sequence[Reading],
    driven: tuple[float, float, float],
) -> list[list[Step]]:
    """Return the stages: training of the baseline, which the others reuse in part; of the others; evaluation.

    Args:
        driven: driving for training, validation and test, for estimates of durations [s].
    """
    size = settings.size
    first: list[Step] = []
    others: list[Step] = []
    for model in models:
        for seed in range(size.seeds):
            folder = settings.runs / model.folder(seed)
            training = Step(
                f"train {model.label}, seed {seed}",
                _cost_of_training(settings, model, driven),
                (folder / "model.json").exists,
                partial(train_run, settings, model, seed),
                partial(_best_epoch, folder),
            )
            (first if model.model == BASELINE else others).append(training)
    runs = [settings.runs / model.folder(seed) for model in models for seed in range(size.seeds)]
    on_map = len(runs) * WINDOW_SECONDS + MAP_SECONDS
    cost = {
        "map": 1 + on_map * driven[2] / size.snapshot_seconds,
        "recorded": 1 + 0.3 * len(runs) * WINDOW_SECONDS * driven[2] / DT / size.stride,
    }
    evaluations = [
        Step(
            "evaluate all runs " + (f"at recorded places, {chosen}" if chosen else "on the map"),
            cost[lookup or "map"],
            partial(_evaluated, runs, (lookup, chosen)),
            partial(evaluate_all, settings, runs, (lookup, chosen)),
        )
        for lookup, chosen in readings
    ]
    return [first, others, evaluations]


def _cost_of_training(settings: ReproductionSettings, model: FigureModel, driven: tuple[float, float, float]) -> float:
    train = settings.size.train
    windows = (driven[0] + driven[1] / 3) / DT / train.stride
    if model.model == BASELINE:  # fits the stages that others reuse
        return 10 + WINDOW_SECONDS * windows * (train.epochs + train.bicycle_epochs + train.actuator_epochs)
    return 2 + WINDOW_SECONDS * windows * train.epochs * READING


def _best_epoch(run: Path) -> str:
    """Describe the best epoch of a run's network; "" for models without a network."""
    best = best_epochs(run).get("model")
    return "" if best is None else best.line("network")


def _evaluated(runs: Sequence[Path], reading: Reading) -> bool:
    return all(errors_path(run, reading).exists() for run in runs)
