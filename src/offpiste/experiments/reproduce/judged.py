"""What a run got wrong, window by window, kept on disk: judging goes on where it stopped, and figures draw from it."""

from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.errors import RunError
from offpiste.evaluation.judge import Errors, predict
from offpiste.evaluation.ways import Way
from offpiste.experiments.reproduce.models import feature_sets
from offpiste.experiments.reproduce.settings import Figure, Size
from offpiste.files import write_whole
from offpiste.progress import track
from offpiste.training.run import Run

PART = "test"


def ways(figure: Figure, *, mapped: bool) -> list[Way]:
    """Where the models of a figure read the ground: under recorded wheels by feature set, and on the map.

    Args:
        mapped: whether the dataset keeps maps.
    """
    recorded: list[Way] = [("recorded", name) for name in feature_sets(figure)]
    return recorded + ([("map", None)] if mapped else [])


def errors_path(run: Path, way: Way) -> Path:
    """Where the errors of a run are kept: in its own folder, so that they go with it."""
    return run / "judged" / f"{'-'.join(filter(None, way))}.safetensors"


def judged_windows(windows: Windows, way: Way, stride: int) -> np.ndarray:
    """Windows that are judged: a stride apart, or those with a snapshot of the map."""
    if way[0] == "map":
        return windows.judged(stride)
    every = windows.every(stride)
    return every if len(every) else np.arange(len(windows))


def judge(run: Run, windows: Windows, way: Way, size: Size, scale: torch.Tensor) -> None:
    """Judge a run in one way, and keep the errors.

    Args:
        windows: of the test part.
        scale: of the loss, the same for all runs.
    """
    lookup, chosen = way
    errors = predict(
        run.dynamics,
        windows.reading(chosen) if chosen else windows,
        judged_windows(windows, way, size.stride),
        lookup=lookup,
        scale=scale,
        weights=torch.tensor(run.weights.in_order()),
        track=track,
        description=f"judging {run.folder.name}",
    )
    arrays = {"drive": errors.drive, "row": errors.row, "values": errors.values, "loss": errors.loss}
    kept = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    write_whole(errors_path(run.folder, way), lambda partial: save_file(kept, partial))


def read_errors(run: Path, way: Way) -> Errors:
    """What `judge` kept.

    Raises:
        RunError: not there, or damaged.
    """
    path = errors_path(run, way)
    try:
        return Errors(**load_file(path))
    except (OSError, SafetensorError, TypeError) as error:
        raise RunError(f"cannot be read: {error}", where=path, how="delete it and run again") from error


def mapped(dataset: Dataset) -> bool:
    """Whether windows of the test part have maps to be read at predicted places."""
    return bool(Windows(dataset, PART).maps.any)
