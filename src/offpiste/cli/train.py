"""`offpiste train`."""

from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from shlex import join
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.errors import RunError
from offpiste.training.config import TrainConfig


@COMMANDS.register("train")
@dataclass(frozen=True)
class Train:
    """Train a model on a dataset."""

    dataset: tyro.conf.Positional[Path]
    """What `extract` wrote."""
    out: Path
    """Folder of the run."""
    train: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)
    resume: bool = False
    """Resume an interrupted run after its last whole epoch."""
    folds: int = 0
    """Blocked cross-validation: that many runs in OUT/fold-K, each with its own split, everything fitted anew."""
    tensorboard: bool = False
    """Also write TensorBoard files (needs the extra `tensorboard`)."""
    ddp: bool = False
    """One of several processes: `torchrun --nproc-per-node 2 -m offpiste train ... --ddp`. The batch is shared out."""

    def run(self) -> int:
        """Open, train, save."""
        from offpiste.dataset.store import open_dataset
        from offpiste.training.distributed import ALONE, joined
        from offpiste.training.train import train, train_folds

        dataset = open_dataset(self.dataset)
        if self.folds:
            if self.ddp:
                raise RunError("--folds and --ddp exclude each other", how="train the folds one after the other")
            train_folds(dataset, self.train, self.out, folds=self.folds, resume=self.resume)
            self._say_next()
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
            if group.writes:
                self._say_next()
        return 0

    def _say_next(self) -> None:
        from offpiste.progress import show

        command = ["offpiste", "evaluate", str(self.out), "--dataset", str(self.dataset)]
        if Path("report").exists():  # the default, which may hold another run's
            command += ["--out", f"report-{self.out.name}"]
        show(f"next: {join(command)}")
