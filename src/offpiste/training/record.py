"""Where the numbers of a training go: a line of JSON an epoch, a line for a person, TensorBoard if wanted."""

import json
from collections.abc import Callable
from pathlib import Path

from offpiste.errors import RunError

Record = Callable[[dict[str, float | int | str]], None]
"""Takes one line of metrics."""


def metrics_writer(path: Path, tell: Callable[[str], None]) -> Record:
    """Appends each line of metrics to `metrics.jsonl` and tells a person."""

    def record(line: dict[str, float | int | str]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        tell(
            f"{line['stage']:>10} {line['epoch']:>3}  train {line['train_loss']:.4f}  "
            f"validation {line['validation_loss']:.4f}  {line['seconds']:.1f} s"
        )

    return record


def also_tensorboard(record: Record, folder: Path) -> Record:
    """The same, and scalars for TensorBoard.

    Raises:
        RunError: TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise RunError("TensorBoard is not installed", how="pip install 'offpiste[tensorboard]'") from error
    writer = SummaryWriter(folder)

    def both(line: dict[str, float | int | str]) -> None:
        record(line)
        for key in ("train_loss", "validation_loss", "seconds"):
            writer.add_scalar(f"{line['stage']}/{key}", float(line[key]), int(line["epoch"]))
        writer.flush()

    return both
