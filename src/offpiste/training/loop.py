"""Training loop of one stage: Adam, a checkpoint after every epoch, and the epoch with the least validation loss."""

import ctypes
import json
import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.core.errors import RunError, TrainingError, extra
from offpiste.core.files import write_text
from offpiste.core.progress import track
from offpiste.dataset.feature_sets import Draw
from offpiste.dataset.windows import Batch, Windows
from offpiste.native.threads import single_threaded_torch
from offpiste.training.batches import batches_of, draw_sets
from offpiste.training.checkpoint import load_checkpoint, load_tensors, load_weights, save_checkpoint, save_tensors
from offpiste.training.config import TrainConfig
from offpiste.training.distributed import ALONE, Group

logger = logging.getLogger(__name__)

REMEDY: Final = "lower the learning rate; the last good checkpoint is kept, and --resume continues from it"

EVALUATED_AT_ONCE: Final = 512
"""Number of validation windows per batch, unless the training batch is larger."""

FEW_WINDOWS: Final = 200
"""Number of validation windows below which the choice of an epoch is unreliable (overlapping windows of about 10 s)."""

_RECENT: Final = 3
"""Number of last epochs whose improvement decides whether a stage has converged."""

_CONVERGED: Final = 0.01
"""Relative improvement of the validation loss below which a stage has converged."""

EPOCH_SETTINGS: Final = {"bicycle": "bicycle_epochs", "model": "epochs"}
"""Setting with the number of epochs, by name of the stage; the actuators always converge."""

_CHECKPOINTED: Final = ("epoch", "losses", "best_epoch", "best_score")
"""Attributes of a `StageState` in a checkpoint, besides weights and optimiser."""

Metrics = dict[str, float | int | str]
"""Numbers of one epoch, with the name of its stage and its number."""

Record = Callable[[Metrics], None]
"""Receives the metrics of one epoch."""


@dataclass(frozen=True)
class BestEpoch:
    """Epoch with the least validation loss."""

    epoch: int  # its number, from 1; 0: the initial weights
    epochs: int  # number of epochs of the stage
    validation_loss: float
    gained: float | None = None  # relative improvement over the last epochs; None if there were too few

    @classmethod
    def last_of(cls, epoch: int, losses: Sequence[float], epochs: int, best: float) -> "BestEpoch":
        """Compute the improvement from the validation losses of all epochs."""
        before = min(losses[:-_RECENT], default=None)
        return cls(epoch, epochs, best, None if not before else max(1 - best / before, 0.0))

    @property
    def has_converged(self) -> bool:
        """Whether an earlier epoch was better than the last one, or the last epochs hardly improved."""
        gains = self.gained is None or self.gained > _CONVERGED
        return not (self.epoch == self.epochs > 1 and gains)

    def line(self, stage: str) -> str:
        """Return a line for the log."""
        loss = f"validation {self.validation_loss:.4f}"
        if self.epoch == 0:
            return f"{stage}: kept the initial weights, {loss}: no epoch of {self.epochs} was better"
        return f"{stage}: kept epoch {self.epoch} of {self.epochs}, {loss}"

    def warnings(self, stage: str) -> Iterator[str]:
        """Yield warnings about the choice of this epoch."""
        if stage not in EPOCH_SETTINGS:
            return
        if not self.has_converged:
            yield (
                f"{stage}: the last epoch is the best: training may not have converged; train again, into another "
                f"--out, with more than {self.epochs} --{EPOCH_SETTINGS[stage].replace('_', '-')}"
            )
        elif self.epoch == 1 and self.epochs > 1:
            yield (
                f"{stage}: the first epoch is the best: validation may differ from training, or the learning rate may "
                "be too high"
            )


def metrics_writer(folder: Path, *, tensorboard: bool = False) -> Record:
    """Return a function that logs an epoch and adds it to `metrics.jsonl` in a run's folder, and to TensorBoard."""
    writer = None
    path = folder / "metrics.jsonl"
    if tensorboard:
        with extra("tensorboard"):
            from torch.utils.tensorboard import SummaryWriter
        writer = SummaryWriter(folder / "tensorboard")

    def record(line: Metrics) -> None:
        before = path.read_text("utf-8").splitlines() if path.exists() else []
        others = [each for each in map(json.loads, before) if any(each[key] != line[key] for key in ("stage", "epoch"))]
        write_text(path, "".join(json.dumps(each) + "\n" for each in [*others, line]))
        logger.info(
            f"{line['stage']:>10} {line['epoch']:>3}  train {line['train_loss']:.4f}  "
            f"validation {line['validation_loss']:.4f}  {line['seconds']:.1f} s"
        )
        if writer is not None:
            for key in ("train_loss", "validation_loss", "seconds"):
                writer.add_scalar(f"{line['stage']}/{key}", float(line[key]), int(line["epoch"]))
            writer.flush()

    return record


@dataclass(frozen=True)
class Stage:
    """One stage of a training.

    Its epoch is chosen by `on_map`, the mean loss on the maps of validation windows; without it, by the mean of `loss`
    over all validation windows, at recorded places.
    """

    name: str  # also the stem of its files
    module: nn.Module  # whose parameters are fitted, unless they require no gradient
    loss: Callable[[Batch], Float[Tensor, " B"]]  # of each window of a batch
    epochs: int  # passes over the training windows
    draw: Draw | None = None  # draws the feature sets that windows read; None: the windows' own
    on_map: Callable[[], float] | None = None


def run_stage(
    stage: Stage,
    train: Windows,
    validation: Windows,
    config: TrainConfig,
    folder: Path,
    record: Record,
    group: Group = ALONE,
) -> BestEpoch:
    """Fit the stage's module and leave its best weights in it and in `<folder>/<stage>.safetensors`.

    The initial weights count as epoch 0. A finished stage is read back; an interrupted one resumes after its last
    complete epoch and ends with the same weights as without the interruption. Several processes take the steps of a
    single one, up to rounding.

    Raises:
        TrainingError: a loss or a gradient is not finite, or all validation losses. The last good checkpoint stays.
        RunError: the file of a finished stage is damaged or of another version.
    """
    keep_freed_memory()
    done, running = folder / f"{stage.name}.safetensors", folder / f"{stage.name}.checkpoint.safetensors"
    if done.exists():
        weights, about = load_tensors(done)
        load_weights(stage.module, weights, done)
        if group.writes:
            running.unlink(missing_ok=True)
        try:
            return BestEpoch(**about)
        except TypeError as error:
            how = "delete the file and resume: the stage is trained again"
            raise RunError("was written by another version of offpiste", where=done, how=how) from error
    state = StageState(stage, config)
    if running.exists():
        state.restore(running)
    else:
        state.keep_if_best(_score(stage, validation, config, group))
    for epoch in range(state.epoch, stage.epochs):
        began = time.perf_counter()
        with single_threaded_torch():
            loss = train_epoch(stage, state, train, config, epoch, group)
            score = _score(stage, validation, config, group)
        state.epoch = epoch + 1
        state.keep_if_best(score)
        state.losses.append(score)
        record(
            {
                "stage": stage.name,
                "epoch": epoch + 1,
                "train_loss": loss,
                "validation_loss": score,
                "validation_on": "recorded" if stage.on_map is None else "map",
                "seconds": round(time.perf_counter() - began, 3),
            }
        )
        if group.writes:
            state.save(running)
    if not math.isfinite(state.best_score):
        how = "inspect the logs of the validation part, and leave out damaged drives"
        raise TrainingError("no epoch has a finite validation loss", where=stage.name, how=how)
    load_weights(stage.module, state.best, done)
    best = BestEpoch.last_of(state.best_epoch, state.losses, stage.epochs, state.best_score)
    if group.writes:
        save_tensors(done, state.best, **asdict(best))
        running.unlink(missing_ok=True)
    group.together(None)
    return best


def keep_freed_memory() -> None:
    """Let glibc's allocator reuse large blocks in the whole process, which saves a tenth of each step."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(-3, 1 << 30)  # M_MMAP_THRESHOLD: smaller blocks come from the heap
        mallopt(-1, (1 << 31) - 1)  # M_TRIM_THRESHOLD: this much of the heap is kept


def _score(stage: Stage, windows: Windows, config: TrainConfig, group: Group) -> float:
    """Return the validation loss by which the epoch is chosen: on maps, or over windows `config.stride` rows apart."""
    if stage.on_map is not None:
        return stage.on_map()
    index, rng = windows.strided(config.stride), np.random.default_rng(config.seed)
    parts = np.array_split(index, math.ceil(len(index) / max(EVALUATED_AT_ONCE, config.batch)))
    sets = [draw_sets(stage.draw, windows, part, rng) for part in parts]
    total = torch.zeros((), dtype=torch.float64, device=windows.device)
    with torch.no_grad():
        for number in range(group.rank, len(parts), group.size):
            total += stage.loss(windows.gather(parts[number], sets[number])).double().sum()
    return float(group.sum(total)) / len(index)


class StageState:
    """State of a running stage, as in its checkpoint: weights, best weights, optimiser, losses, next epoch."""

    def __init__(self, stage: Stage, config: TrainConfig) -> None:
        self.module = stage.module
        self.names: dict[Tensor, str] = {p: name for name, p in stage.module.named_parameters() if p.requires_grad}
        constants = [p for p, name in self.names.items() if name.split(".")[-1] == "raw"]
        networks = [p for p, name in self.names.items() if name.split(".")[-1] != "raw"]
        groups = [(networks, config.learning_rate), (constants, config.constants_learning_rate)]
        self.optimiser = torch.optim.Adam([{"params": p, "lr": lr, "peak": lr} for p, lr in groups if p])
        self.best, self.best_score, self.best_epoch, self.epoch = self._weights(), math.inf, 0, 0
        self.losses: list[float] = []

    def keep_if_best(self, score: float) -> None:
        """Keep the weights if their validation loss is the least so far."""
        if score < self.best_score:
            self.best, self.best_score, self.best_epoch = self._weights(), score, self.epoch

    def save(self, path: Path) -> None:
        """Write the checkpoint."""
        about = {name: getattr(self, name) for name in _CHECKPOINTED}
        save_checkpoint(path, {"now": self._weights(), "best": self.best}, self.optimiser, **about)

    def restore(self, path: Path) -> None:
        """Continue from a checkpoint."""
        weights, about = load_checkpoint(path, self.optimiser)
        load_weights(self.module, weights["now"], path)
        self.best = weights["best"]
        for name in _CHECKPOINTED:
            setattr(self, name, about[name])

    def _weights(self) -> dict[str, Tensor]:
        return {name: value.detach().clone() for name, value in self.module.state_dict().items()}


def train_epoch(
    stage: Stage, state: StageState, train: Windows, config: TrainConfig, epoch: int, group: Group
) -> float:
    """Take the steps of one epoch and return the mean training loss."""
    # The order follows from seed and epoch alone, so that a resumed run equals an uninterrupted one.
    rng = np.random.default_rng((config.seed, epoch))
    order = rng.permutation(train.strided(config.stride, phase=int(rng.integers(config.stride))))
    parts = np.array_split(order, math.ceil(len(order) / config.batch))
    batches, total = batches_of(train, parts, stage.draw, rng, group), 0.0
    for number, index in enumerate(track(parts, f"{stage.name} {epoch + 1}/{stage.epochs}")):
        _set_learning_rate(state.optimiser, (epoch + number / len(parts)) / stage.epochs)
        where = f"{stage.name}, epoch {epoch + 1}, batch {number + 1}"
        try:
            batch = next(batches)
            loss = torch.zeros((), device=train.device) if batch is None else stage.loss(batch).sum() / len(index)
        except TrainingError as error:
            raise TrainingError(error.what, where=where, how=error.how) from error
        mean = group.sum(loss.detach())
        if not torch.isfinite(mean):
            raise TrainingError("the loss is not finite", where=where, how=REMEDY)
        state.optimiser.zero_grad()
        if loss.requires_grad:
            loss.backward()  # type: ignore[no-untyped-call]
        group.sum_gradients(state.names)
        for parameter, name in state.names.items():
            if parameter.grad is not None and not torch.isfinite(parameter.grad).all():
                raise TrainingError(f"the gradient of '{name}' is not finite", where=where, how=REMEDY)
        nn.utils.clip_grad_norm_(list(state.names), config.gradient_clip)
        state.optimiser.step()
        total += mean.item() * len(index)
    return total / len(order)


def _set_learning_rate(optimiser: torch.optim.Adam, progress: float) -> None:
    """Warm up over the first 5 %, then follow a half cosine down to a hundredth (Loshchilov and Hutter 2017)."""
    # Progress is a fraction of the stage, since the number of batches differs between epochs.
    warm = min(1.0, progress / 0.05 + 0.1)
    factor = warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))
    for group in optimiser.param_groups:
        group["lr"] = group["peak"] * factor
