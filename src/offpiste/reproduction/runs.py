"""Stages of a training that are the same for every model of one seed.

What a run got wrong, window by window, kept on disk: judging goes on where it stopped, and figures draw from it.

Train and judge the models of a figure: a piece a run, done once, shared by both figures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import torch

from offpiste.conventions import DT
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.error_files import save_errors
from offpiste.evaluation.errors import Errors, prediction_errors
from offpiste.evaluation.evaluated_models import Reading
from offpiste.files import write_bytes
from offpiste.progress import track
from offpiste.reproduction.pieces import Piece
from offpiste.reproduction.settings import BASELINE, Figure, Member, Reproduction, feature_sets
from offpiste.training.prediction import MapSource
from offpiste.training.run import Run, load_run, refuse_seen
from offpiste.training.terrain_sources import on_map
from offpiste.training.train import train

STAGES = ("actuators", "bicycle")
"""They know nothing of terrain features: what one model fitted serves all."""


def reuse_stages(runs: Path, folder: Path, seed: int) -> None:
    """Give a run the stages that a run of the same seed has fitted already; folders are called NAME-SEED.

    Args:
        runs: folder of all runs, of one dataset and with the same settings of these stages.
        folder: of the run.
    """
    for stage in STAGES:
        name = f"{stage}.safetensors"
        done = sorted(runs.glob(f"*-{seed}/{name}"))
        if done and not (folder / name).exists():
            write_bytes(folder / name, done[0].read_bytes())


PART = "test"


def readings(figure: Figure, *, mapped: bool) -> list[Reading]:
    """Where the models of a figure read the ground: under recorded wheels by feature set, and on the map.

    Args:
        mapped: whether the dataset keeps maps.
    """
    recorded: list[Reading] = [("recorded", name) for name in feature_sets(figure)]
    return recorded + ([("map", None)] if mapped else [])


def errors_path(run: Path, reading: Reading) -> Path:
    """Where the errors of a run are kept: in its own folder, so that they go with it."""
    return run / "errors" / f"{'-'.join(filter(None, reading))}.safetensors"


def evaluation_windows(windows: Windows, reading: Reading, stride: int) -> np.ndarray:
    """Windows that are judged: a stride apart, or those with a snapshot of the map."""
    if reading[0] == "map":
        return windows.judged(stride)
    every = windows.every(stride)
    return every if len(every) else np.arange(len(windows))


def run_errors(
    run: Run,
    windows: Windows,
    index: np.ndarray,
    reading: Reading,
    *,
    scale: torch.Tensor,
    map_source: MapSource = on_map,
) -> Errors:
    """Errors of a run that reads the terrain in one way.

    Args:
        index: of the windows.
        scale: of the loss, the same for all runs.
        map_source: the map that is read, where it is not the windows' own.
    """
    lookup, chosen = reading
    return prediction_errors(
        run.dynamics,
        windows.reading(chosen) if chosen else windows,
        index,
        lookup=lookup,
        scale=scale,
        weights=torch.tensor(run.weights.in_order()),
        map_source=map_source,
        track=track,
        description=f"evaluating {run.folder.name}",
    )


def mapped(dataset: Dataset) -> bool:
    """Whether windows of the test part have maps to be read at predicted places."""
    return bool(Windows(dataset, PART).maps.any)


WINDOW_SECONDS, READING = 0.5e-3, 1.8
"""What a window costs the kernels, about; and how much more it does with features."""

MAP_SECONDS = 0.08
"""What a window costs on a map of its own, about."""


@dataclass(frozen=True)
class Driven:
    """Seconds of driving to train, validate and test on; what pieces cost follows from them."""

    train: float
    validation: float
    test: float


def driven_in(dataset: Dataset) -> Driven:
    """Of a dataset."""
    return Driven(*(DT * sum(int((d.part == part).sum()) for d in dataset.drives) for part in range(len(PARTS))))


@dataclass(frozen=True)
class Work:
    """Trains and judges runs on a dataset, and opens nothing before it is needed."""

    asked: Reproduction
    dataset: Dataset

    @cached_property
    def windows(self) -> Windows:
        """That models are judged on."""
        return Windows(self.dataset, PART, start="causal", device=self.asked.device)

    @cached_property
    def scale(self) -> torch.Tensor:
        """Units of the loss: those of the first `b`, for all runs alike."""
        return load_run(self.asked.runs / f"{BASELINE}-0").scale


def train_run(asked: Reproduction, member: Member, seed: int) -> None:
    """Train a run, or go on with it."""
    folder = asked.runs / member.folder(seed)
    reuse_stages(asked.runs, folder, seed)
    config = member.config(asked.size, seed, asked.device)
    train(open_dataset(asked.data), config, folder, resume=(folder / "config.json").exists())


def evaluate_run(asked: Reproduction, member: Member, seed: int, readings: Sequence[Reading]) -> None:
    """Judge a run in the ways that are missing."""
    work = Work(asked, open_dataset(asked.data))
    run = load_run(asked.runs / member.folder(seed), device=asked.device)
    refuse_seen(run, work.dataset, PART)
    for reading in readings:
        if not errors_path(run.folder, reading).exists():
            index = evaluation_windows(work.windows, reading, asked.size.stride)
            errors = run_errors(run, work.windows, index, reading, scale=work.scale)
            save_errors(errors_path(run.folder, reading), errors)


def model_stages(
    asked: Reproduction, members: Sequence[Member], readings: Sequence[Reading], driven: Driven
) -> list[list[Piece]]:
    """Training of the baseline, which fits what others reuse; training of these; judging of all.

    Args:
        driven: how much, or how much there will be.
    """
    first: list[Piece] = []
    others: list[Piece] = []
    judged: list[Piece] = []
    for member in members:
        for seed in member.seeds(asked.size):
            folder = asked.runs / member.folder(seed)
            name = f"{member.label}, seed {seed}"
            training = Piece(
                f"train {name}",
                _cost_of_training(asked, member, driven),
                (folder / "model.json").exists,
                partial(train_run, asked, member, seed),
            )
            (first if member.model == BASELINE else others).append(training)
            judged.append(
                Piece(
                    f"judge {name}",
                    _cost_of_judging(asked, readings, driven),
                    partial(_judged, folder, readings),
                    partial(evaluate_run, asked, member, seed, readings),
                )
            )
    return [first, others, judged]


def _judged(folder: Path, readings: Sequence[Reading]) -> bool:
    return all(errors_path(folder, reading).exists() for reading in readings)


def _cost_of_training(asked: Reproduction, member: Member, driven: Driven) -> float:
    train = asked.size.train
    windows = driven.train / DT / train.stride + driven.validation / DT / train.stride / 3
    if member.model == BASELINE:  # the first of its seed: it fits what others reuse, and kernels are compiled
        return WINDOW_SECONDS * windows * (train.epochs + train.bicycle_epochs + train.actuator_epochs) + 10
    return WINDOW_SECONDS * windows * train.epochs * READING + 2


def _cost_of_judging(asked: Reproduction, readings: Sequence[Reading], driven: Driven) -> float:
    recorded = 0.5 * WINDOW_SECONDS * driven.test / DT / asked.size.stride
    on_map = MAP_SECONDS * driven.test / asked.size.snapshot_seconds
    return sum(on_map if lookup == "map" else recorded for lookup, _ in readings) + 1
