"""Training and evaluation steps of a figure's models: one per run, one per terrain lookup."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path

import numpy as np
import torch

from offpiste.core.checksums import CHECKSUMS
from offpiste.core.conventions import DT
from offpiste.core.files import write_bytes
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, errors_of_models, save_errors
from offpiste.evaluation.evaluate import Reading
from offpiste.reproduction.data import opened
from offpiste.reproduction.settings import BASELINE, Figure, FigureModel, ReproductionSettings, feature_sets
from offpiste.reproduction.steps import Step
from offpiste.training.checkpoint import SHARED_STAGES
from offpiste.training.distributed import ALONE
from offpiste.training.losses import MapLoss, map_loss
from offpiste.training.run import Run, best_epochs, load_run, refuse_seen
from offpiste.training.train import train


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


PART = "test"
"""Evaluated part of the split."""


def figure_readings(figure: Figure, *, mapped: bool) -> list[Reading]:
    """Return the terrain lookups of a figure: at recorded places by feature set, and on the map if there are maps."""
    recorded: list[Reading] = [("recorded", name) for name in feature_sets(figure)]
    return recorded + ([("map", None)] if mapped else [])


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


def mapped(dataset: Dataset) -> bool:
    """Whether windows of the test part have maps."""
    return bool(Windows(dataset, PART).maps.any)


WINDOW_SECONDS, READING = 0.5e-3, 1.8
"""Estimated time of the kernels per window [s], and a factor for models that read features."""

MAP_SECONDS = 0.02
"""Estimated time to read a window's own map [s]."""


@dataclass(frozen=True)
class DrivenTime:
    """Seconds of driving by part, for estimates of step durations."""

    train: float
    validation: float
    test: float


def driven_time(dataset: Dataset) -> DrivenTime:
    """Return the seconds of driving in a dataset, by part."""
    return DrivenTime(*(DT * sum(int((d.part == part).sum()) for d in dataset.drives) for part in range(len(PARTS))))


@dataclass(frozen=True)
class EvaluationData:
    """Dataset, windows and loss units of an evaluation."""

    settings: ReproductionSettings
    dataset: Dataset

    @cached_property
    def windows(self) -> Windows:
        """Windows of the test part."""
        return Windows(self.dataset, PART, start="causal", device=self.settings.device)

    @cached_property
    def scale(self) -> torch.Tensor:
        """Units of the loss of the first `b`, used for all runs."""
        return load_run(self.settings.runs / f"{BASELINE}-0").scale


@lru_cache(maxsize=1)
def _with_maps(settings: ReproductionSettings, start: str, version: tuple[int, ...]) -> tuple[Dataset, MapLoss | None]:
    """Open the dataset and the maps of its validation windows; cached, by a version that changes with the dataset."""
    dataset = opened(settings)
    return dataset, map_loss(Windows(dataset, "validation", start=start), ALONE)


def train_run(settings: ReproductionSettings, model: FigureModel, seed: int) -> None:
    """Train a run, or resume its training."""
    folder = settings.runs / model.folder(seed)
    reuse_stages(settings.runs, folder, seed)
    config = model.config(settings.size, seed, settings.device)
    written = tuple(path.stat().st_mtime_ns for path in sorted(settings.data.glob(f"*/{CHECKSUMS}")))
    dataset, maps = _with_maps(settings, config.start, written)
    train(dataset, config, folder, resume=(folder / "config.json").exists(), maps=maps)


def evaluate_all(settings: ReproductionSettings, runs: Sequence[Path], reading: Reading) -> None:
    """Compute and save the missing errors of runs with one terrain lookup."""
    missing = [folder for folder in runs if not errors_path(folder, reading).exists()]
    data = EvaluationData(settings, opened(settings))
    loaded = [load_run(folder, device=settings.device) for folder in missing]
    for run in loaded:
        refuse_seen(run, data.dataset, PART)
    index = evaluation_windows(data.windows, reading, settings.size.stride)
    for run, errors in zip(loaded, errors_of_runs(loaded, data.windows, index, reading, scale=data.scale), strict=True):
        save_errors(errors_path(run.folder, reading), errors)


def model_stages(
    settings: ReproductionSettings, models: Sequence[FigureModel], readings: Sequence[Reading], driven: DrivenTime
) -> list[list[Step]]:
    """Return the stages: training of the baseline, which the others reuse in part; of the others; evaluation."""
    first: list[Step] = []
    others: list[Step] = []
    for model in models:
        for seed in range(settings.size.seeds):
            training = Step(
                f"train {model.label}, seed {seed}",
                _cost_of_training(settings, model, driven),
                (settings.runs / model.folder(seed) / "model.json").exists,
                partial(train_run, settings, model, seed),
                partial(_kept, settings.runs / model.folder(seed)),
            )
            (first if model.model == BASELINE else others).append(training)
    runs = [settings.runs / model.folder(seed) for model in models for seed in range(settings.size.seeds)]
    evaluations = [
        Step(
            "evaluate all runs " + ("on the map" if reading[0] == "map" else f"at recorded places, {reading[1]}"),
            _cost_of_evaluation(settings, reading, len(runs), driven),
            partial(_evaluated, runs, reading),
            partial(evaluate_all, settings, runs, reading),
        )
        for reading in sorted(readings, key=lambda reading: reading[0] != "map")  # the longest first
    ]
    return [first, others, evaluations]


def _kept(run: Path) -> str:
    """Describe the best epoch of a run's network; "" for models without a network."""
    kept = best_epochs(run).get("model")
    return "" if kept is None else kept.line("network")


def _evaluated(runs: Sequence[Path], reading: Reading) -> bool:
    return all(errors_path(run, reading).exists() for run in runs)


def _cost_of_training(settings: ReproductionSettings, model: FigureModel, driven: DrivenTime) -> float:
    train = settings.size.train
    windows = driven.train / DT / train.stride + driven.validation / DT / train.stride / 3
    if model.model == BASELINE:  # fits the stages that others reuse, and compiles kernels
        return WINDOW_SECONDS * windows * (train.epochs + train.bicycle_epochs + train.actuator_epochs) + 10
    return WINDOW_SECONDS * windows * train.epochs * READING + 2


def _cost_of_evaluation(settings: ReproductionSettings, reading: Reading, runs: int, driven: DrivenTime) -> float:
    size = settings.size
    if reading[0] == "map":
        return driven.test / size.snapshot_seconds * (MAP_SECONDS + WINDOW_SECONDS * runs) + 1
    return 0.3 * WINDOW_SECONDS * runs * driven.test / DT / size.stride + 1
