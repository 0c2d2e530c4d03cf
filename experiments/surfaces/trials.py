"""One training of the study and its evaluation; processes import it from here."""

from dataclasses import dataclass
from pathlib import Path

import torch

from experiments.surfaces.labels import Labels, held_out, relabelled
from offpiste.conventions import EVALUATION_STRIDE
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, prediction_errors
from offpiste.parallel import Report
from offpiste.reproduction.runs import reuse_stages
from offpiste.training.config import TrainConfig
from offpiste.training.run import load_run
from offpiste.training.train import train


@dataclass(frozen=True)
class Trial:
    """One training: what a process needs to know.

    Attributes:
        label: what the recordings are labelled by.
        tested: recordings that are held out.
    """

    dataset: Path
    folder: Path
    label: str
    labels: Labels
    tested: tuple[str, ...]
    config: TrainConfig

    def data(self) -> Dataset:
        """The recordings under these labels, some held out."""
        return held_out(relabelled(open_dataset(self.dataset), self.labels), self.tested)

    def errors(self, labels: Labels | None = None) -> Errors:
        """How far the trained model is off on the held-out recordings, under these or other labels."""
        run = load_run(self.folder)
        dataset = self.data() if labels is None else relabelled(self.data(), labels)
        windows = Windows(dataset, "test")
        weights = torch.tensor(run.weights.in_order())
        index = windows.evaluation_indices(EVALUATION_STRIDE)
        return prediction_errors(run.dynamics, windows, index, lookup="recorded", scale=run.scale, weights=weights)


def train_once(trial: Trial, report: Report) -> str:
    """Train, unless that was done; says what was trained."""
    if not (trial.folder / "model.json").exists():
        reuse_stages(trial.folder.parent, trial.folder, trial.config.seed)
        train(trial.data(), trial.config, trial.folder, resume=(trial.folder / "config.json").exists())
    return f"{trial.folder.parent.name} {trial.folder.name}"
