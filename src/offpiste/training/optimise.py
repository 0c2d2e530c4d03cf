"""One stage of training: Adam on a multi-step loss, metrics and a checkpoint an epoch, the best epoch by validation."""

import ctypes
import json
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.compilation import single_threaded_torch
from offpiste.core.errors import TrainingError, extra
from offpiste.core.files import write_text
from offpiste.core.progress import track
from offpiste.dataset.feature_sets import Draw
from offpiste.dataset.windows import Batch, Windows
from offpiste.training.batches import batches_of, draw_sets
from offpiste.training.checkpoint import load_checkpoint, load_tensors, load_weights, save_checkpoint, save_tensors
from offpiste.training.config import TrainConfig
from offpiste.training.distributed import ALONE, Group
from offpiste.training.kept_epoch import KeptEpoch
from offpiste.training.mirror import Mirror

logger = logging.getLogger(__name__)

EVALUATED_AT_ONCE: Final = 512
"""Windows, where a batch is not larger."""

Metrics = dict[str, float | int | str]
"""Numbers of one epoch, with the names of its stage and its number."""

Record = Callable[[Metrics], None]
"""Takes the metrics of one epoch."""


def metrics_of(path: Path) -> list[Metrics]:
    """The epochs in a file of JSON lines; none where there is no file."""
    return [json.loads(text) for text in path.read_text("utf-8").splitlines()] if path.exists() else []


def write_metrics(path: Path, lines: Sequence[Metrics]) -> None:
    """Add epochs to a file of JSON lines; one that is there already is replaced."""
    new = {(line["stage"], line["epoch"]) for line in lines}
    others = [line for line in metrics_of(path) if (line["stage"], line["epoch"]) not in new]
    write_text(path, "".join(json.dumps(line) + "\n" for line in [*others, *lines]))


def metrics_writer(path: Path) -> Record:
    """A record that adds each epoch to a file of JSON lines (`write_metrics`) and logs it."""

    def record(line: Metrics) -> None:
        write_metrics(path, [line])
        logger.info(
            f"{line['stage']:>10} {line['epoch']:>3}  train {line['train_loss']:.4f}  "
            f"validation {line['validation_loss']:.4f}  {line['seconds']:.1f} s"
        )

    return record


def check_tensorboard() -> None:
    """Check that scalars can be written for TensorBoard.

    Raises:
        MissingExtra: it is not installed.
    """
    with extra("tensorboard"):
        import torch.utils.tensorboard  # noqa: F401


def also_tensorboard(record: Record, folder: Path) -> Record:
    """A record that also writes scalars for TensorBoard.

    Raises:
        MissingExtra: TensorBoard is not installed.
    """
    check_tensorboard()
    from torch.utils.tensorboard import SummaryWriter

    writer = SummaryWriter(folder)

    def both(line: Metrics) -> None:
        record(line)
        for key in ("train_loss", "validation_loss", "seconds"):
            writer.add_scalar(f"{line['stage']}/{key}", float(line[key]), int(line["epoch"]))
        writer.flush()

    return both


REMEDY: Final = "lower the learning rate; the last good checkpoint is kept, and --resume continues from it"


@dataclass(frozen=True)
class Stage:
    """What one stage fits.

    Attributes:
        name: stage, and stem of its files.
        module: holds the parameters; those that require no gradient stay.
        loss: loss of each window of a batch.
        epochs: passes over the training windows.
        draw: feature sets that windows read; the windows' own where there is none.
        on_map: mean loss of the module on maps of validation, by which epochs are chosen; None: by the mean of `loss`
            over all validation windows, at recorded places.
        mirror: of half of the windows that it trains on; None for none.
    """

    name: str
    module: nn.Module
    loss: Callable[[Batch], Float[Tensor, " B"]]
    epochs: int
    draw: Draw | None = None
    on_map: Callable[[], float] | None = None
    mirror: Mirror | None = None


def run_stage(
    stage: Stage,
    train: Windows,
    validation: Windows,
    config: TrainConfig,
    folder: Path,
    record: Record,
    group: Group = ALONE,
) -> KeptEpoch:
    """Fit the stage's module and leave its best weights in it and in `<folder>/<stage>.safetensors`.

    Returns:
        which epoch that was.

    The weights that it begins with compete: a network that no epoch improves leaves the physics as it is.
    A finished stage is read back; an interrupted one resumes after its last whole epoch and comes to the same weights
    as without the interruption. Several processes take the steps that one alone would, up to rounding.

    Raises:
        TrainingError: a loss or a gradient is not finite. The last good checkpoint stays.
    """
    keep_freed_memory()
    done, running = folder / f"{stage.name}.safetensors", folder / f"{stage.name}.checkpoint.safetensors"
    if done.exists():
        weights, about = load_tensors(done)
        load_weights(stage.module, weights, done)
        if group.writes:
            running.unlink(missing_ok=True)
        return KeptEpoch.of(about, stage.epochs)
    state = _State(stage, config)
    if running.exists():
        state.restore(running)
    else:
        state.keep_if_best(_score(stage, validation, config, group))
    for epoch in range(state.epoch, stage.epochs):
        began = time.perf_counter()
        with single_threaded_torch():
            loss = _train_epoch(stage, state, train, config, epoch, group)
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
    load_weights(stage.module, state.best, done)
    kept = KeptEpoch.last_of(state.best_epoch, state.losses, stage.epochs, state.best_score)
    if group.writes:
        save_tensors(done, state.best, **kept.about())
        running.unlink(missing_ok=True)
    group.together(None)
    return kept


def keep_freed_memory() -> None:
    """Let the allocator keep large blocks for the next step, a tenth of which is spent on having their pages cleared.

    Of the process; does nothing where the allocator is not glibc's.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(-3, 1 << 30)  # M_MMAP_THRESHOLD: blocks below it come from the heap
        mallopt(-1, (1 << 31) - 1)  # M_TRIM_THRESHOLD: so much of the heap stays


def _score(stage: Stage, validation: Windows, config: TrainConfig, group: Group) -> float:
    """What epochs are chosen by; the least is best."""
    return stage.on_map() if stage.on_map is not None else mean_loss(stage, validation, config, group)


def mean_loss(stage: Stage, windows: Windows, config: TrainConfig, group: Group = ALONE) -> float:
    """Mean loss over the evaluation windows of a part, without gradients."""
    index, rng = windows.strided(config.stride), np.random.default_rng(config.seed)
    parts = np.array_split(index, math.ceil(len(index) / max(EVALUATED_AT_ONCE, config.batch)))
    feature_set_choice = [draw_sets(stage.draw, windows, part, rng) for part in parts]
    total = torch.zeros((), dtype=torch.float64, device=windows.device)
    with torch.no_grad():
        for number, part in group.mine(parts):
            total += stage.loss(windows.gather(part, feature_set_choice[number])).double().sum()
    return float(group.sum(total)) / len(index)


class _State:
    """What a checkpoint holds: weights, now and the best so far, the optimiser's state, losses, the next epoch."""

    def __init__(self, stage: Stage, config: TrainConfig) -> None:
        self.module = stage.module
        free = {p: name for name, p in stage.module.named_parameters() if p.requires_grad}
        self.names: dict[Tensor, str] = dict(free.items())
        constants = [p for p, name in free.items() if name.split(".")[-1] == "raw"]
        networks = [p for p, name in free.items() if name.split(".")[-1] != "raw"]
        groups = [(networks, config.learning_rate), (constants, config.constants_learning_rate)]
        self.optimiser = torch.optim.Adam([{"params": p, "lr": lr, "peak": lr} for p, lr in groups if p])
        self.best, self.best_score, self.epoch = self._weights(), math.inf, 0
        self.best_epoch: int | None = 0
        self.losses: list[float] = []

    def keep_if_best(self, score: float) -> None:
        if score < self.best_score:
            self.best, self.best_score, self.best_epoch = self._weights(), score, self.epoch

    def save(self, path: Path) -> None:
        weights = {"now": self._weights(), "best": self.best}
        best = {"best_score": self.best_score, "best_epoch": self.best_epoch}
        save_checkpoint(path, weights, self.optimiser, epoch=self.epoch, losses=self.losses, **best)

    def restore(self, path: Path) -> None:
        weights, about = load_checkpoint(path, self.optimiser)
        load_weights(self.module, weights["now"], path)
        self.best, self.best_score, self.epoch = weights["best"], about["best_score"], about["epoch"]
        self.best_epoch = about.get("best_epoch")
        self.losses = about.get("losses", [self.best_score] * self.epoch)  # an older checkpoint has the least one only

    def _weights(self) -> dict[str, Tensor]:
        return {name: value.detach().clone() for name, value in self.module.state_dict().items()}


def _train_epoch(stage: Stage, state: _State, train: Windows, config: TrainConfig, epoch: int, group: Group) -> float:
    # The order follows from seed and epoch alone, so that a resumed run sees what an uninterrupted one would.
    rng = np.random.default_rng((config.seed, epoch))
    order = rng.permutation(train.strided(config.stride, phase=int(rng.integers(config.stride))))
    parts = np.array_split(order, math.ceil(len(order) / config.batch))
    batches, total = batches_of(train, parts, stage.draw, rng, group, stage.mirror), 0.0
    for number, index in enumerate(track(parts, f"{stage.name} {epoch + 1}/{stage.epochs}")):
        _set_learning_rate(state.optimiser, (epoch + number / len(parts)) / stage.epochs)
        where = f"{stage.name}, epoch {epoch + 1}, batch {number + 1}"
        try:
            loss = _share_of_loss(stage, next(batches), len(index), train.device)
        except TrainingError as error:
            raise TrainingError(error.what, where=where, how=error.how) from error
        mean = group.sum(loss.detach())
        if not torch.isfinite(mean):
            raise TrainingError("the loss is not finite", where=where, how=REMEDY)
        state.optimiser.zero_grad()
        if loss.requires_grad:
            loss.backward()  # type: ignore[no-untyped-call]
        group.sum_gradients(state.names)
        _check_gradients(state, where)
        nn.utils.clip_grad_norm_(list(state.names), config.gradient_clip)
        state.optimiser.step()
        total += mean.item() * len(index)
    return total / len(order)


def _share_of_loss(stage: Stage, batch: Batch | None, count: int, device: torch.device) -> Float[Tensor, ""]:
    """What this process's windows add to the mean loss of a batch of `count`."""
    return torch.zeros((), device=device) if batch is None else stage.loss(batch).sum() / count


def _check_gradients(state: _State, where: str) -> None:
    for parameter, name in state.names.items():
        if parameter.grad is not None and not torch.isfinite(parameter.grad).all():
            raise TrainingError(f"the gradient of '{name}' is not finite", where=where, how=REMEDY)


def _set_learning_rate(optimiser: torch.optim.Adam, progress: float) -> None:
    """Warm up over the first 5 %, then a half cosine down to a hundredth (Loshchilov and Hutter 2017)."""
    # By the share of the stage that is done, not by steps: epochs differ in their number of batches, and torch's
    # schedulers count steps.
    warm = min(1.0, progress / 0.05 + 0.1)
    factor = warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))
    for group in optimiser.param_groups:
        group["lr"] = group["peak"] * factor
