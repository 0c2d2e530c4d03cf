"""Metrics of a training: a line of JSON after each epoch, a line in the log, TensorBoard where it is asked for."""

import json
import logging
from collections.abc import Callable
from pathlib import Path

from offpiste.extras import extra

logger = logging.getLogger(__name__)

Record = Callable[[dict[str, float | int | str]], None]
"""Takes the metrics of one epoch."""


def metrics_writer(path: Path) -> Record:
    """A record that appends each epoch to a file of JSON lines and logs it."""

    def record(line: dict[str, float | int | str]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        logger.info(
            f"{line['stage']:>10} {line['epoch']:>3}  train {line['train_loss']:.4f}  "
            f"validation {line['validation_loss']:.4f}  {line['seconds']:.1f} s"
        )

    return record


def also_tensorboard(record: Record, folder: Path) -> Record:
    """A record that also writes scalars for TensorBoard.

    Raises:
        MissingExtra: TensorBoard is not installed.
    """
    with extra("tensorboard"):
        from torch.utils.tensorboard import SummaryWriter
    writer = SummaryWriter(folder)

    def both(line: dict[str, float | int | str]) -> None:
        record(line)
        for key in ("train_loss", "validation_loss", "seconds"):
            writer.add_scalar(f"{line['stage']}/{key}", float(line[key]), int(line["epoch"]))
        writer.flush()

    return both
