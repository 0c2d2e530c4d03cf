"""`offpiste train`."""

from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line
from offpiste.core.errors import RunError, require
from offpiste.training.config import TrainConfig

_COMPARED = 3
"""Largest number of compared runs in the next command."""


@COMMANDS.register("train")
@dataclass(frozen=True)
class Train:
    """Train a model on a dataset."""

    dataset: tyro.conf.Positional[Path]
    """Dataset written by `extract`."""
    out: Path
    """Run folder."""
    train: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)
    resume: bool = False
    """Resume an interrupted run after its last complete epoch."""
    folds: int = 0
    """Number of folds of a blocked cross-validation: a run each in OUT/fold-K, trained on its own split."""
    tensorboard: bool = False
    """Also write TensorBoard files (needs the extra `tensorboard`)."""
    ddp: bool = False
    """Distribute each batch over processes: `torchrun --nproc-per-node 2 -m offpiste train ... --ddp`."""

    def run(self) -> int:
        """Train one run or a run per fold."""
        from offpiste.dataset.store import open_dataset
        from offpiste.training.distributed import ALONE, joined
        from offpiste.training.train import train, train_folds

        if self.tensorboard:
            require("tensorboard", "tensorboard")
        dataset = open_dataset(self.dataset)
        if self.folds:
            if self.ddp:
                raise RunError("--folds and --ddp exclude each other", how="leave out one of them")
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
        """Show stages that have not converged, a network that adds nothing, and the command that evaluates the run."""
        from offpiste.core.progress import show
        from offpiste.training.checkpoint import fold_folders
        from offpiste.training.loop import EPOCH_SETTINGS
        from offpiste.training.run import best_epochs

        runs = [best_epochs(run) for run in (fold_folders(self.out) if self.folds else [self.out])]
        stages = {stage for best in runs for stage, epoch in best.items() if not epoch.has_converged}
        if more := [name for stage, name in EPOCH_SETTINGS.items() if stage in stages]:
            twice = " ".join(f"--{name.replace('_', '-')} {2 * getattr(self.train, name)}" for name in more)
            show(f"not converged yet: train again with {twice} --out {self.out}-longer")
        if not self.folds and "bicycle" in runs[0] and runs[0]["model"].epoch == 0:  # its initial weights
            what = "the network brings no improvement here: this run predicts by its physics alone"
            show(f"{what}; more driving may help")
        # The default folder may hold the report of another run.
        out = ["--out", f"report-{self.out.name}"] if Path("report").exists() else []
        show(next_line("evaluate", self.out, *self._beside(), "--dataset", self.dataset, *out))

    def _beside(self) -> list[str]:
        """Return runs of other models on the same dataset in the same folder, for comparison."""
        from offpiste.training.run import model_trained_on

        others: dict[str, str] = {}
        for path in sorted(self.out.resolve().parent.iterdir()):
            model = model_trained_on(path, self.dataset)
            if model and model != self.train.model:  # two runs of one model would count as seeds
                others.setdefault(model, str(self.out.with_name(path.name)))
        return list(others.values())[:_COMPARED]
