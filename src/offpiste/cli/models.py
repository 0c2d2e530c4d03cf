"""Commands about models: train one, judge some."""

from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from offpiste.conventions import FEATURE_SETS
from offpiste.errors import RunError
from offpiste.training.config import TrainConfig


@dataclass(frozen=True)
class Train:
    """Train a model on a dataset."""

    dataset: tyro.conf.Positional[Path]
    out: Path
    """Folder of the run."""
    train: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)
    resume: bool = False
    """Go on after the last whole epoch of an interrupted run."""
    folds: int = 0
    """Blocked cross-validation: that many runs in OUT/fold-K, each with its own split, everything fitted anew."""
    tensorboard: bool = False
    """Also write TensorBoard files (needs the extra `tensorboard`)."""
    ddp: bool = False
    """One of several processes: `torchrun --nproc-per-node 2 -m offpiste train ... --ddp`. The batch is shared out."""

    def run(self) -> int:
        """Open, train, save."""
        from offpiste.dataset.store import open_dataset
        from offpiste.training.cross_validation import train_folds
        from offpiste.training.distributed import ALONE, joined
        from offpiste.training.train import train

        dataset = open_dataset(self.dataset)
        if self.folds:
            if self.ddp:
                raise RunError("--folds and --ddp do not go together", how="train the folds one after the other")
            train_folds(dataset, self.train, self.out, folds=self.folds, resume=self.resume)
            return 0
        with joined(self.train.device) if self.ddp else nullcontext(ALONE) as group:
            train(
                dataset,
                self.train,
                self.out,
                resume=self.resume,
                tensorboard=self.tensorboard,
                group=group,
            )
        return 0


@dataclass(frozen=True)
class Evaluate:
    """Judge runs on the test part of a dataset; writes metrics.json, pictures and report.html."""

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """Run folders; a folder of folds counts as its folds."""
    dataset: Path
    """The dataset they were trained on, or another one."""
    out: Path = Path("report")
    """Folder of the report."""
    lookup: Literal["recorded", "map", "both"] = "both"
    """Where models read the ground: under the recorded wheels, or where they predict to be, as a planner does."""
    feature_set: Literal["hindsight", "-20", "-10", "0", "10", "20", "30", "40", "all"] = "hindsight"
    """Views that are read at recorded places: from how far ahead [m], or the last there were."""
    device: str = "cpu"

    def run(self) -> int:
        """Load, judge, report."""
        from offpiste.evaluation.evaluate_runs import evaluate_runs

        lookups: tuple[Literal["recorded", "map"], ...] = ("recorded", "map")
        evaluate_runs(
            self.runs,
            self.dataset,
            self.out,
            lookups=lookups if self.lookup == "both" else (self.lookup,),
            feature_sets=FEATURE_SETS if self.feature_set == "all" else (self.feature_set,),
            device=self.device,
        )
        return 0
