"""Prediction errors after each second, and their files."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from safetensors import SafetensorError
from safetensors.numpy import save_file
from torch import Tensor

from offpiste.core.conventions import DT
from offpiste.core.errors import RunError
from offpiste.core.files import write_whole
from offpiste.core.limits import open_tensors
from offpiste.core.progress import track
from offpiste.core.state import wrap_angle
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Dynamics
from offpiste.training.losses import summed_loss
from offpiste.training.prediction import Lookup, in_parts, roll_out

HORIZONS = (1, 2, 3, 4, 5)
"""Times of the errors [s after the start]."""

ERROR_NAMES = ("distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "yaw_rate_error_radps")
"""Absolute errors; yaw wraps around."""


Taken = TypeVar("Taken", bound="Errors")


@dataclass(frozen=True)
class Errors:
    """Prediction errors of a run by window, or of S runs; infinite if the prediction is not finite.

    Attributes:
        drive, row: index of each window's drive in the dataset, and row of its start.
        values: by horizon (`HORIZONS`) and component (`ERROR_NAMES`).
        loss: over all steps, in units of the kinematic bicycle's error (`offpiste.training.losses`).
    """

    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    values: Float[np.ndarray, "*S n 5 5"]
    loss: Float[np.ndarray, "*S n"]

    @property
    def key(self) -> Int[np.ndarray, " n"]:
        """Key of each window, ordered by drive and row."""
        return np.asarray(self.drive.astype(np.int64) << 32 | self.row)

    @property
    def failed(self) -> Bool[np.ndarray, "*S n 5"]:
        """Whether the prediction is not finite, by window and horizon."""
        return np.asarray(~np.isfinite(self.values).all(axis=-1))

    def component(self, name: str, horizon: int = -1) -> Float[np.ndarray, "*S n"]:
        """Return one of `ERROR_NAMES` at an index of `HORIZONS`, or the "loss" over all steps."""
        return self.loss if name == "loss" else self.values[..., horizon, ERROR_NAMES.index(name)]

    def distance(self) -> Float[np.ndarray, "*S n"]:
        """Return the distance error at the last horizon [m]."""
        return self.component("distance_error_m")

    def take(self: Taken, index: Int[np.ndarray, " m"]) -> Taken:
        """Return the errors of some windows."""
        values, loss = self.values[..., index, :, :], self.loss[..., index]
        return replace(self, drive=self.drive[index], row=self.row[index], values=values, loss=loss)


def pool(runs: Sequence[Errors]) -> Errors:
    """Average the errors of runs by window; windows in ascending order.

    Seeds predict the same windows, and folds disjoint ones. Errors are averaged rather than predictions, which would be
    an ensemble. If one run failed in a window, the mean has failed.
    """
    keys, place = np.unique(np.concatenate([run.key for run in runs]), return_inverse=True)
    count = np.bincount(place).astype(float)
    values, loss = np.zeros((len(keys), *runs[0].values.shape[1:])), np.zeros(len(keys))
    np.add.at(values, place, np.concatenate([run.values for run in runs]))
    np.add.at(loss, place, np.concatenate([run.loss for run in runs]))
    return Errors(keys >> 32, keys & 0xFFFFFFFF, values / count[:, None, None], loss / count)


@dataclass(frozen=True)
class SeededErrors(Errors):
    """Errors of a model's runs on the same windows in ascending order, one run per seed.

    Attributes:
        seeds: of the runs; None if unknown.
    """

    seeds: tuple[int | None, ...]

    @property
    def mean(self) -> Errors:
        """Mean of each window over the seeds."""
        return Errors(self.drive, self.row, self.values.mean(axis=0), self.loss.mean(axis=0))

    def of_seed(self, seed: int | None) -> "SeededErrors":
        """Return the run of a seed, or all runs if there is none."""
        if seed is None or seed not in self.seeds:
            return self
        run = [self.seeds.index(seed)]
        return replace(self, values=self.values[run], loss=self.loss[run], seeds=(seed,))


def by_seed(runs: Sequence[Errors], seeds: Sequence[int | None]) -> SeededErrors:
    """Return the runs of a model in the order of their seeds; folds of a seed are concatenated.

    If seeds predict different windows (as folds of one seed each), all are one run.
    """
    different = sorted(set(seeds), key=lambda seed: (seed is not None, seed))
    together = [pool([run for run, own in zip(runs, seeds, strict=True) if own == seed]) for seed in different]
    if any(not np.array_equal(run.key, together[0].key) for run in together):
        together, different = [pool(runs)], [None]
    values, loss = np.stack([run.values for run in together]), np.stack([run.loss for run in together])
    return SeededErrors(together[0].drive, together[0].row, values, loss, tuple(different))


def positions(windows: Errors, among: Errors) -> Int[np.ndarray, " n"]:
    """Return the indices of windows in `among`, which contains all of them in ascending order."""
    have, wanted = among.key, windows.key
    result = np.searchsorted(have, wanted)
    assert np.array_equal(have[np.minimum(result, len(have) - 1)], wanted), "not the same windows"
    return np.asarray(result)


@torch.no_grad()
def errors_of_models(
    models: Sequence[tuple[Dynamics, Float[Tensor, " 5"]]],
    windows: Windows,
    index: Int[np.ndarray, " n"],
    *,
    lookup: Lookup | None,
    scale: Float[Tensor, " 5"],
    description: str = "evaluating",
) -> list[Errors]:
    """Compute the errors of models on the same windows, each read once.

    Args:
        models: each with the weights of its loss.
        index: indices of the windows.
        lookup: "recorded" or "map" (`training.prediction.Lookup`); None for models that do not read the terrain.
        scale: of the loss (`offpiste.training.losses.summed_loss`).
        description: of the progress.
    """
    steps = torch.tensor([round(seconds / DT) - 1 for seconds in HORIZONS], device=windows.device)
    scale = scale.to(windows.device)
    values: list[list[Tensor]] = [[] for _ in models]
    losses: list[list[Tensor]] = [[] for _ in models]
    for part in track(in_parts(index, windows, lookup), description):
        batch = windows.gather(part)
        for number, (dynamics, weights) in enumerate(models):
            state = roll_out(dynamics, windows, part, lookup, batch)[1].state
            values[number].append(_absolute_errors(state[:, steps], batch.target[:, steps]))
            losses[number].append(summed_loss(state, batch.target, scale, weights.to(windows.device)))
    drive, row = windows.drive[index], windows.row_in_drive(index)
    measured = ((_infinite_if_failed(torch.cat(of)) for of in both) for both in zip(values, losses, strict=True))
    return [Errors(drive, row, *both) for both in measured]


@torch.no_grad()
def trajectories(
    dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " n"], *, lookup: Lookup | None
) -> Float[np.ndarray, "n T 6"]:
    """Predict the states after each step, with positions relative to the start."""
    if not len(index):
        return np.empty((0, windows.horizon, 6))
    states = [roll_out(dynamics, windows, part, lookup)[1].state for part in in_parts(index, windows, lookup)]
    return np.asarray(torch.cat(states).cpu().numpy())


def _absolute_errors(predicted: Float[Tensor, "B 5 6"], target: Float[Tensor, "B 5 6"]) -> Float[Tensor, "B 5 5"]:
    difference = predicted - target
    distance = difference[..., :2].norm(dim=-1)
    yaw = wrap_angle(difference[..., 2])
    return torch.stack((distance, yaw, *difference[..., 3:].unbind(dim=-1)), dim=-1).abs()


def _infinite_if_failed(values: Tensor) -> np.ndarray:
    """Convert to double precision; if one component of a horizon is not finite, all become infinite."""
    array = values.double().cpu().numpy()
    finite = np.isfinite(array)
    if array.ndim == 3:
        finite = np.broadcast_to(finite.all(axis=2, keepdims=True), array.shape)
    return np.where(finite, array, np.inf)


def save_errors(path: Path, errors: Errors) -> None:
    """Write errors as safetensors, whole or not at all."""
    arrays = {"drive": errors.drive, "row": errors.row, "values": errors.values, "loss": errors.loss}
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    write_whole(path, lambda partial: save_file(contiguous, partial))


def load_errors(path: Path) -> Errors:
    """Read errors written by `save_errors`.

    Raises:
        RunError: no such file, or it is damaged.
    """
    try:
        with open_tensors(path, "numpy") as file:
            return Errors(**{name: file.get_tensor(name) for name in file.keys()})  # noqa: SIM118
    except (OSError, SafetensorError, TypeError) as error:
        raise RunError(f"cannot be read: {error}", where=path, how="delete it and run again") from error
