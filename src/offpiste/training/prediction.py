"""Predictions of windows: a batch over its recorded terrain, as training rolls out, or any windows of a dataset."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, Literal, get_args

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from offpiste.core.channels import absent_value
from offpiste.core.errors import DatasetError, OffpisteError, did_you_mean
from offpiste.core.state import RecordedTerrain, TerrainSource, Trajectory
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics, Vehicle, rollout
from offpiste.dynamics.header.gpu import gpu_kernels
from offpiste.dynamics.header.recorded import rollout_by_kernels
from offpiste.dynamics.kernels.autograd import rollout_recorded, supports
from offpiste.dynamics.kernels.map_rollout import predict_on
from offpiste.training.terrain_sources import encoded, on_map

Lookup = Literal["recorded", "map"]
"""Where a model reads the terrain: under the wheels' recorded future places, or on a map at predicted places."""

MapSource = Callable[[Dynamics, Windows, np.ndarray, Batch], tuple[Batch, TerrainSource]]
"""From a model, windows, their indices and their encoded batch to the batch and the map that the model reads."""

AT_ONCE: Final = 1024
"""Windows that are rolled out side by side."""

AT_ONCE_ON_SNAPSHOTS: Final = 32
"""The same where each has a map of its own, some 10 MB each."""


def predict(dynamics: Dynamics, batch: Batch) -> Trajectory:
    """Roll out a batch of windows over its recorded terrain, by the kernels where they can, with gradients."""
    batch = encoded(dynamics, batch)
    model_state = dynamics.start(batch.history, batch.state, batch.actuators)
    if supports(dynamics, batch.state.device, batch.state.dtype):
        return rollout_recorded(dynamics, model_state, batch.control, batch.terrain)
    kernels = gpu_kernels(dynamics, batch.state.device, batch.state.dtype)
    if kernels is not None:
        return rollout_by_kernels(kernels, dynamics, model_state, batch.control, batch.terrain)
    return rollout(dynamics, model_state, batch.control, RecordedTerrain(batch.terrain))


@torch.no_grad()
def predict_windows(dynamics: Dynamics, windows: Windows, lookup: Lookup = "recorded") -> Trajectory:
    """Predicted states and actuators of windows; positions are relative to each window's start.

    Raises:
        DatasetError: no window, the model reads features and the dataset has none, or the map is asked for and a
            window does not start with one.
        OffpisteError: no such lookup.
    """
    if lookup not in get_args(Lookup):
        how = f"{did_you_mean(lookup, get_args(Lookup))}there are: {', '.join(get_args(Lookup))}"
        raise OffpisteError(f"no lookup '{lookup}'", how=how)
    if not len(windows):
        raise DatasetError("no window to predict", how="give at least one")
    parts = in_parts(np.arange(len(windows)), windows, lookup)
    result = [roll_out(dynamics, windows, part, lookup)[1] for part in parts]
    return Trajectory(torch.cat([part.state for part in result]), torch.cat([part.actuators for part in result]))


def in_parts(
    index: Int[np.ndarray, " n"], windows: Windows, lookup: Lookup | None, size: int | None = None
) -> list[np.ndarray]:
    """Indices of windows in parts that are rolled out side by side.

    Args:
        size: of a part, where it is not the usual one.
    """
    usual = AT_ONCE_ON_SNAPSHOTS if lookup == "map" and windows.maps.snapped.any() else AT_ONCE
    size = size or usual
    return [index[first : first + size] for first in range(0, len(index), size)]


def roll_out(
    dynamics: Dynamics,
    windows: Windows,
    index: Int[np.ndarray, " B"],
    lookup: Lookup | None,
    map_source: MapSource = on_map,
) -> tuple[Batch, Trajectory]:
    """Some windows as one batch, and what the model predicts for them.

    Args:
        lookup: None for models that do not read the terrain.
        map_source: the map that "map" reads, where it is not the windows' own.
    """
    batch = batch_for(dynamics, windows, windows.gather(index))
    return batch, roll_batch_out(dynamics, windows, index, batch, lookup, map_source)


def batch_for(dynamics: Dynamics, windows: Windows, batch: Batch) -> Batch:
    """A batch of these windows in the columns that a model reads."""
    return in_columns_of(dynamics.vehicle, batch, [control.name for control in windows.dataset.rig.controls])


def roll_batch_out(
    dynamics: Dynamics,
    windows: Windows,
    index: Int[np.ndarray, " B"],
    batch: Batch,
    lookup: Lookup | None,
    map_source: MapSource = on_map,
) -> Trajectory:
    """What a model predicts for a batch of windows.

    Args:
        index: of the windows in the batch.
        batch: in the model's columns (`batch_for`).
        lookup, map_source: as of `roll_out`.
    """
    if lookup != "map":
        return predict(dynamics, batch)
    batch, source = map_source(dynamics, windows, index, encoded(dynamics, batch))
    start = dynamics.start(batch.history, batch.state, batch.actuators)
    return predict_on(dynamics, start, batch.control, source)


def in_columns_of(vehicle: Vehicle, batch: Batch, columns: Sequence[str]) -> Batch:
    """A batch whose controls have the columns that models of a vehicle read; `Control.absent` where it lacks one.

    Args:
        columns: that the batch has.
    """
    wanted = vehicle.control_columns
    if wanted == tuple(columns):
        return batch

    def chosen(values: Tensor) -> Tensor:
        there = dict(zip(columns, values.unbind(-1), strict=True))
        absent = {name: torch.full_like(values[..., 0], absent_value(name)) for name in wanted if name not in there}
        return torch.stack([(there | absent)[name] for name in wanted], dim=-1)

    past = replace(batch.history, control=chosen(batch.history.control))
    return replace(batch, history=past, control=chosen(batch.control))
