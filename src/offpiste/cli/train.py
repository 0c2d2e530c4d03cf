"""`offpiste train`."""

from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import join
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line
from offpiste.core.command_line import options
from offpiste.core.errors import RunError
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
        from offpiste.training.loop import check_tensorboard
        from offpiste.training.train import train, train_folds

        if self.tensorboard:
            check_tensorboard()
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
        """Show the command that evaluates the run, and one with more epochs if a stage has not converged."""
        from offpiste.core.progress import show

        if (again := self._with_more_epochs()) is not None:
            show(f"not converged yet; with twice the epochs: {again}")
        if self._adds_nothing():
            show(
                "the network brings no improvement here: this run predicts by its physics alone; more driving may help"
            )
        if not self.folds and (network := self._with_a_network()) is not None:
            show(f"to test whether a network helps: {network}")
        # The default folder may hold the report of another run.
        out = ["--out", f"report-{self.out.name}"] if Path("report").exists() else []
        show(next_line("evaluate", self.out, *self._beside(), "--dataset", self.dataset, *out))

    def _adds_nothing(self) -> bool:
        """Return whether the network kept its initial weights, which correct nothing."""
        from offpiste.training.run import best_epochs

        best = {} if self.folds else best_epochs(self.out)
        return "bicycle" in best and best["model"].epoch == 0

    def _with_a_network(self) -> str | None:
        """Return the command that trains `b` after a model without a network; None if its folder exists."""
        out = self.out.with_name("b")
        if self.train.model != "parametric" or out.exists():
            return None
        command = ["offpiste", "train", str(self.dataset), "--out", str(out)]
        return join([*command, *options(replace(self.train, model="b"))])

    def _beside(self) -> list[str]:
        """Return runs of other models on the same dataset in the same folder, for comparison."""
        from offpiste.training.run import model_trained_on

        others: dict[str, str] = {}
        for path in sorted(self.out.resolve().parent.iterdir()):
            model = model_trained_on(path, self.dataset)
            if model and model != self.train.model:  # two runs of one model would count as seeds
                others.setdefault(model, str(self.out.with_name(path.name)))
        return list(others.values())[:_COMPARED]

    def _with_more_epochs(self) -> str | None:
        """Return the command with twice the epochs of the stages that have not converged; None if all have."""
        from offpiste.training.checkpoint import fold_folders
        from offpiste.training.loop import EPOCH_SETTINGS
        from offpiste.training.run import best_epochs

        runs = fold_folders(self.out) if self.folds else [self.out]
        stages = {
            stage
            for run in runs
            for stage, best in best_epochs(run).items()
            if stage in EPOCH_SETTINGS and not best.has_converged
        }
        if not stages or self.ddp:
            return None
        more = {name: 2 * getattr(self.train, name) for stage, name in EPOCH_SETTINGS.items() if stage in stages}
        command = ["offpiste", "train", str(self.dataset), "--out", f"{self.out}-longer"]
        command += options(replace(self.train, **more))
        command += ["--folds", str(self.folds)] if self.folds else []
        return join([*command, "--tensorboard"] if self.tensorboard else command)
