"""Train and judge the models of a figure: a piece a run, done once, shared by both figures."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import torch

from offpiste.conventions import DT
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.ways import Way
from offpiste.experiments.reproduce.judged import PART, errors_path, judge
from offpiste.experiments.reproduce.models import Member
from offpiste.experiments.reproduce.plan import Piece
from offpiste.experiments.reproduce.results import BASELINE
from offpiste.experiments.reproduce.settings import Reproduction
from offpiste.experiments.shared_stages import reuse_stages
from offpiste.training.run import load_run, refuse_seen
from offpiste.training.train import train

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


def judge_run(asked: Reproduction, member: Member, seed: int, ways: Sequence[Way]) -> None:
    """Judge a run in the ways that are missing."""
    work = Work(asked, open_dataset(asked.data))
    run = load_run(asked.runs / member.folder(seed), device=asked.device)
    refuse_seen(run, work.dataset, PART)
    for way in ways:
        if not errors_path(run.folder, way).exists():
            judge(run, work.windows, way, asked.size, work.scale)


def model_stages(
    asked: Reproduction, members: Sequence[Member], ways: Sequence[Way], driven: Driven
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
                    _cost_of_judging(asked, ways, driven),
                    partial(_judged, folder, ways),
                    partial(judge_run, asked, member, seed, ways),
                )
            )
    return [first, others, judged]


def _judged(folder: Path, ways: Sequence[Way]) -> bool:
    return all(errors_path(folder, way).exists() for way in ways)


def _cost_of_training(asked: Reproduction, member: Member, driven: Driven) -> float:
    train = asked.size.train
    windows = driven.train / DT / train.stride + driven.validation / DT / train.stride / 3
    if member.model == BASELINE:  # the first of its seed: it fits what others reuse, and kernels are compiled
        return WINDOW_SECONDS * windows * (train.epochs + train.bicycle_epochs + train.actuator_epochs) + 10
    return WINDOW_SECONDS * windows * train.epochs * READING + 2


def _cost_of_judging(asked: Reproduction, ways: Sequence[Way], driven: Driven) -> float:
    recorded = 0.5 * WINDOW_SECONDS * driven.test / DT / asked.size.stride
    on_map = MAP_SECONDS * driven.test / asked.size.snapshot_seconds
    return sum(on_map if lookup == "map" else recorded for lookup, _ in ways) + 1
