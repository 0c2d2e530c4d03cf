"""Roll models out over windows and keep how far each prediction is off after every whole second."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from offpiste.conventions import DT
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics, rollout
from offpiste.geometry import wrap_angle
from offpiste.state import TerrainSource
from offpiste.training.losses import summed_loss
from offpiste.training.terrain_sources import encoded, on_map
from offpiste.training.train import predict as predict_recorded

HORIZONS = (1, 2, 3, 4, 5)
"""When errors are kept [s after the start]."""

COMPONENTS = ("distance_error_m", "yaw_error_rad", "vx_error_mps", "vy_error_mps", "yaw_rate_error_radps")
"""What is kept then: absolute errors, of the position as a distance, of yaw wrapped."""

LOOKUPS = ("recorded", "map")
"""Where a model reads the ground: under the recorded future wheels, or where it predicts itself to be."""

CHUNK = 1024
"""Windows rolled out side by side."""

SNAPSHOT_CHUNK = 32
"""The same where each has a map of its own: some 10 MB each."""

Ground = Callable[[Dynamics, Windows, np.ndarray, Batch], tuple[Batch, TerrainSource]]
"""From a model, windows, their indices and their encoded batch to the batch and the ground that is read on the way."""

Item = TypeVar("Item")


@runtime_checkable
class Track(Protocol):
    """Shows progress over items while they are worked on, as `offpiste.progress.track` does."""

    def __call__(self, items: Iterable[Item], description: str, /) -> Iterator[Item]:
        """The same items."""
        ...


def untracked(items: Iterable[Item], description: str, /) -> Iterator[Item]:
    """No progress shown."""
    return iter(items)


@dataclass(frozen=True)
class Errors:
    """How far predictions are off, window by window.

    A prediction that is not finite is infinitely wrong: it stays in, and no mean or quantile can look good with it.

    Attributes:
        drive, row: what identifies a window: number of its drive in the dataset, and row t in that drive.
        values: by horizon (`HORIZONS`) and component (`COMPONENTS`).
        loss: over all steps, in units of the kinematic bicycle's error (`offpiste.training.losses`).
    """

    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    values: Float[np.ndarray, "n 5 5"]
    loss: Float[np.ndarray, " n"]

    @property
    def key(self) -> Int[np.ndarray, " n"]:
        """One number a window, in the order of drives and rows."""
        return np.asarray(self.drive.astype(np.int64) << 32 | self.row)

    @property
    def failed(self) -> Bool[np.ndarray, "n 5"]:
        """Windows whose prediction was not finite, by horizon."""
        return np.asarray(~np.isfinite(self.values).all(axis=2))

    def distance(self) -> Float[np.ndarray, " n"]:
        """Distance error at the last horizon [m]."""
        return self.values[:, -1, 0]

    def take(self, index: Int[np.ndarray, " m"]) -> "Errors":
        """Some of the windows."""
        return Errors(self.drive[index], self.row[index], self.values[index], self.loss[index])


def predict(
    dynamics: Dynamics,
    windows: Windows,
    index: Int[np.ndarray, " n"],
    *,
    lookup: str | None,
    scale: Float[Tensor, " 5"],
    weights: Float[Tensor, " 5"],
    ground: Ground = on_map,
    chunk: int | None = None,
    track: Track = untracked,
    description: str = "judging",
) -> Errors:
    """Errors of a model on windows.

    Args:
        index: of the windows.
        lookup: "recorded" or "map" (`LOOKUPS`); None for models that do not read the ground.
        scale, weights: of the loss (`offpiste.training.losses.summed_loss`).
        ground: what "map" reads, where it is not the windows' own.
        chunk: windows rolled out side by side, when not `CHUNK` or `SNAPSHOT_CHUNK`.
        track: shows progress over the chunks.
    """
    steps = torch.tensor([round(seconds / DT) - 1 for seconds in HORIZONS], device=windows.device)
    scale, weights = scale.to(windows.device), weights.to(windows.device)
    values, losses = [], []
    for part in track(_chunks(index, chunk or _chunk(windows, lookup)), description):
        batch, state = _rolled_out(dynamics, windows, part, lookup, ground)
        values.append(_absolute_errors(state[:, steps], batch.target[:, steps]))
        losses.append(summed_loss(state, batch.target, scale, weights))
    return Errors(
        windows.drive[index],
        windows.row_in_drive(index),
        _infinite_if_failed(torch.cat(values)),
        _infinite_if_failed(torch.cat(losses)),
    )


def trajectories(
    dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " n"], *, lookup: str | None
) -> Float[np.ndarray, "n T 6"]:
    """Predicted states after each step of some windows, positions relative to each window's start."""
    if not len(index):
        return np.empty((0, windows.horizon, 6))
    states = [_rolled_out(dynamics, windows, part, lookup)[1] for part in _chunks(index, _chunk(windows, lookup))]
    return np.asarray(torch.cat(states).cpu().numpy())


def _chunk(windows: Windows, lookup: str | None) -> int:
    return SNAPSHOT_CHUNK if lookup == "map" and windows.maps.snapped.any() else CHUNK


def _chunks(index: Int[np.ndarray, " n"], size: int) -> list[np.ndarray]:
    return [index[first : first + size] for first in range(0, len(index), size)]


@torch.no_grad()
def _rolled_out(
    dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " B"], lookup: str | None, ground: Ground = on_map
) -> tuple[Batch, Float[Tensor, "B T 6"]]:
    batch = windows.gather(index)
    if lookup != "map":
        return batch, predict_recorded(dynamics, batch).state
    batch = encoded(dynamics, batch)
    batch, source = ground(dynamics, windows, index, batch)
    model_state = dynamics.start(batch.history, batch.state, batch.actuators)
    return batch, rollout(dynamics, model_state, batch.control, source).state


def _absolute_errors(predicted: Float[Tensor, "B 5 6"], target: Float[Tensor, "B 5 6"]) -> Float[Tensor, "B 5 5"]:
    difference = predicted - target
    distance = difference[..., :2].norm(dim=-1)
    yaw = wrap_angle(difference[..., 2])
    return torch.stack((distance, yaw, *difference[..., 3:].unbind(dim=-1)), dim=-1).abs()


def _infinite_if_failed(values: Tensor) -> np.ndarray:
    """Double precision; what is not finite is infinite, in every component of its moment."""
    array = values.double().cpu().numpy()
    finite = np.isfinite(array)
    if array.ndim == 3:
        finite = np.broadcast_to(finite.all(axis=2, keepdims=True), array.shape)
    return np.where(finite, array, np.inf)
