"""Does knowing a real floor help? DART's car on three floors, with the floor's label as a visual feature.

Two halves of the recordings, each tested by models that were trained on the other. Beside the true labels, false ones:
labels that changed places among the recordings, and the recordings' file format. Floor, day and format go together, so
what helps may be knowing the day. A label is the same all over a recording: read at recorded places, it leaks nothing.
`python -m experiments.surfaces ../shared/data/dart --out surfaces`
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
import tyro

from experiments.command import run
from experiments.surfaces.labels import (
    FLOORS,
    Labels,
    extract_floors,
    formats,
    halves,
    recordings,
    shuffled,
)
from experiments.surfaces.tables import Results, tables
from experiments.surfaces.trials import Trial, train_once
from offpiste.errors import DatasetError
from offpiste.evaluation.errors import Errors, pool
from offpiste.files import write_text
from offpiste.parallel import run_all
from offpiste.progress import track
from offpiste.training.config import TrainConfig

logger = logging.getLogger("experiments")

HALVES = (0, 1)


@dataclass(frozen=True)
class Surfaces:
    """Does knowing a real floor help? Extracts, trains and evaluates; resumes where it stopped."""

    dart: tyro.conf.Positional[Path]
    """Folder of the recordings."""
    out: Path = Path("surfaces")
    """Folder of all outputs."""
    seeds: int = 3
    """Runs of each model."""
    permutations: int = 6
    """False labellings, a run each."""
    models: tuple[str, ...] = ("df", "cf")
    """Models that read labels; `b` is compared with them."""
    seed: int = 0
    """Seed of the false labellings."""
    processes: int = 2
    """Trainings at a time."""
    train: TrainConfig = field(default_factory=lambda: TrainConfig(batch=64))
    """Settings of all trainings."""

    def run(self) -> str:
        """The whole experiment.

        Raises:
            LogError: no recordings there.
            DatasetError: a training failed.
        """
        dataset, floors = extract_floors(recordings(self.dart), self.out / "dataset.zarr")
        half = halves(floors)
        blind = self._trials("none", floors, half, ("b",), range(self.seeds))
        reading = self._trials("floor", floors, half, self.models, range(self.seeds))
        reading += self._trials("format", formats(floors), half, self.models, range(self.seeds))
        for number, labels in enumerate(shuffled(floors, half, self.permutations, self.seed)):
            reading += self._trials(f"shuffled{number}", labels, half, self.models, [number % self.seeds])
        for trials in (blind, reading):  # the blind ones fit the bicycles of all
            failed = run_all(train_once, trials, self.processes, "train")
            if failed:
                raise DatasetError(f"{len(failed)} trainings failed; the first: {failed[0]}", where=self.out)
        result = tables(
            self._evaluate(blind + reading, floors), [drive.name for drive in dataset.drives], floors, FLOORS
        )
        write_text(self.out / "surfaces.md", result + "\n")
        return result

    def _trials(
        self, label: str, labels: Labels, half: Labels, models: Sequence[str], seeds: Sequence[int]
    ) -> list[Trial]:
        return [
            Trial(
                self.out / "dataset.zarr",
                self.out / "runs" / f"half-{number}" / f"{label}-{model}-{seed}",
                label,
                labels,
                tuple(name for name in half if half[name] == number),
                replace(self.train, model=model, seed=seed),
            )
            for model in models
            for seed in seeds
            for number in HALVES
        ]

    def _evaluate(self, trials: Sequence[Trial], floors: Labels) -> Results:
        """Errors by label, model and seed, both halves together.

        `exchanged` is trained on the true label and evaluated with others.
        """
        parts: dict[tuple[str, str, int], list[Errors]] = {}
        for trial in track(trials, "evaluate"):
            model, seed = trial.config.model, trial.config.seed
            parts.setdefault((trial.label, model, seed), []).append(trial.errors())
            if trial.label == "floor":
                others = [{name: (floor + by) % len(FLOORS) for name, floor in floors.items()} for by in (1, 2)]
                wrong = pool([trial.errors(labels) for labels in others])
                parts.setdefault(("exchanged", model, seed), []).append(wrong)
        return {key: pool(found) for key, found in parts.items()}


if __name__ == "__main__":
    torch.set_num_threads(1)
    run(Surfaces)
