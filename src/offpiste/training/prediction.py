"""Predictions of windows, and the terrain they read: under recorded wheels, on a map, or along the driven path."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeVar, get_args

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from offpiste.core.channels import absent_value
from offpiste.core.errors import DatasetError, OffpisteError, did_you_mean
from offpiste.core.state import RecordedTerrain, Terrain, TerrainSource, Trajectory
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics, rollout
from offpiste.dynamics.header.gpu import gpu_kernels
from offpiste.dynamics.header.recorded import rollout_by_kernels
from offpiste.dynamics.kernels.autograd import rollout_recorded, supports
from offpiste.dynamics.kernels.encoder import codes_by_cell
from offpiste.dynamics.kernels.map_rollout import predict_on
from offpiste.mapping.terrain_sampler import MapTerrain
from offpiste.native.library import library
from offpiste.native.tensors import call

Lookup = Literal["recorded", "map"]
"""Source of the terrain: under the recorded future positions of the wheels, or on a map at predicted positions."""

Joined = TypeVar("Joined")

AT_ONCE: Final = 1024
"""Number of windows that are rolled out together."""

AT_ONCE_ON_SNAPSHOTS: Final = 32
"""Number of windows that are rolled out together if each has its own map of some 10 MB."""


def predict_batch(dynamics: Dynamics, batch: Batch) -> Trajectory:
    """Roll out a batch over its recorded terrain, with gradients; by kernels if they support the model."""
    return _on_recorded(dynamics, encoded(dynamics, batch))


def _on_recorded(dynamics: Dynamics, batch: Batch) -> Trajectory:
    model_state = dynamics.start(batch.history, batch.state, batch.actuators)
    if supports(dynamics, batch.state.device, batch.state.dtype):
        return rollout_recorded(dynamics, model_state, batch.control, batch.terrain)
    kernels = gpu_kernels(dynamics, batch.state.device, batch.state.dtype)
    if kernels is not None:
        return rollout_by_kernels(kernels, dynamics, model_state, batch.control, batch.terrain)
    return rollout(dynamics, model_state, batch.control, RecordedTerrain(batch.terrain))


@torch.no_grad()
def predict_windows(dynamics: Dynamics, windows: Windows, lookup: Lookup = "recorded") -> Trajectory:
    """Predict states and actuators of windows (`offpiste.predict`); positions are relative to each window's start."""
    if lookup not in get_args(Lookup):
        how = f"{did_you_mean(lookup, get_args(Lookup))}available: {', '.join(get_args(Lookup))}"
        raise OffpisteError(f"no lookup '{lookup}'", how=how)
    if not len(windows):
        raise DatasetError("no window to predict", how="give at least one")
    parts = in_parts(np.arange(len(windows)), windows, lookup)
    return joined([roll_out(dynamics, windows, part, lookup)[1] for part in parts])


def joined(parts: Sequence[Joined]) -> Joined:
    """Concatenate dataclasses of tensors, field by field."""
    kind: Any = type(parts[0])
    return kind(*(torch.cat(values) for values in zip(*(vars(part).values() for part in parts), strict=True)))


def in_parts(
    index: Int[np.ndarray, " n"], windows: Windows, lookup: Lookup | None, size: int | None = None
) -> list[np.ndarray]:
    """Split indices of windows into parts that are rolled out together, of a size or as fits in memory."""
    size = size or (AT_ONCE_ON_SNAPSHOTS if lookup == "map" and windows.maps.snapped.any() else AT_ONCE)
    return [index[first : first + size] for first in range(0, len(index), size)]


def roll_out(
    dynamics: Dynamics,
    windows: Windows,
    index: Int[np.ndarray, " B"],
    lookup: Lookup | None,
    gathered: Batch | None = None,
) -> tuple[Batch, Trajectory, TerrainSource]:
    """Predict windows; return them as an encoded batch in the model's columns, the prediction and the terrain it read.

    Args:
        lookup: None for models that do not read the terrain.
        gathered: the windows if they are gathered already.
    """
    gathered = windows.gather(index) if gathered is None else gathered
    batch = encoded(dynamics, batch_for(dynamics, windows, gathered))
    if lookup != "map":
        return batch, _on_recorded(dynamics, batch), RecordedTerrain(batch.terrain)
    batch, source = on_map(dynamics, windows, index, batch)
    start = dynamics.start(batch.history, batch.state, batch.actuators)
    return batch, predict_on(dynamics, start, batch.control, source), source


def batch_for(dynamics: Dynamics, windows: Windows, batch: Batch) -> Batch:
    """Return a batch of windows with the control columns that a model reads; `Control.absent` for those it lacks."""
    wanted, columns = dynamics.vehicle.control_columns, [control.name for control in windows.dataset.rig.controls]
    if wanted == tuple(columns):
        return batch

    def chosen(values: Tensor) -> Tensor:
        there = dict(zip(columns, values.unbind(-1), strict=True))
        absent = {name: torch.full_like(values[..., 0], absent_value(name)) for name in wanted if name not in there}
        return torch.stack([(there | absent)[name] for name in wanted], dim=-1)

    past = replace(batch.history, control=chosen(batch.history.control))
    return replace(batch, history=past, control=chosen(batch.control))


def encoded(dynamics: Dynamics, batch: Batch) -> Batch:
    """Return a batch whose recorded ground is encoded, each cell once, if the model reads features."""
    encoder = dynamics.encoder
    if encoder is None:
        return batch
    if batch.ground is None:
        what = "the model reads terrain features and the dataset has none"
        raise DatasetError(what, how="extract with --pca (see fit-pca)")
    features, valid = batch.ground.features, batch.ground.valid
    codes = codes_by_cell(encoder, features, valid).to(batch.state.dtype)
    past = replace(batch.history.terrain, latent=codes_of_cells(codes, batch.ground.past))
    return replace(
        batch,
        history=replace(batch.history, terrain=past),
        terrain=replace(batch.terrain, latent=codes_of_cells(codes, batch.ground.ahead)),
    )


def codes_of_cells(codes: Float[Tensor, "M E"], cells: Int[Tensor, "*S"]) -> Float[Tensor, "*S E"]:
    """Return `codes[cells]`, with a gradient that adds up in a fixed order, unlike that of indexing."""
    return _Codes.apply(codes, cells)  # type: ignore[no-untyped-call, no-any-return]


class _Codes(torch.autograd.Function):
    """Codes of cells; the adjoint sums over cells in the order of `cells`."""

    @staticmethod
    def forward(ctx: Any, codes: Tensor, cells: Tensor) -> Tensor:
        """Return codes [*S, E]."""
        ctx.cells, ctx.count = cells, len(codes)
        return _rows(codes, cells)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bar: Tensor) -> tuple[Tensor, None]:
        """Return the adjoint of the codes."""
        sums = bar.new_zeros(ctx.count, bar.shape[-1])
        if not ctx.cells.numel():
            return sums, None
        if bar.device.type == "cpu" and bar.dtype == torch.float32 and library() is not None:
            call("add_by_cell", 1, bar.contiguous(), ctx.cells.flatten().long(), ctx.cells.numel(), len(sums[0]), sums)
            return sums, None
        cells, order = torch.sort(ctx.cells.flatten().int(), stable=True)  # half the bits sort in half the time
        first = torch.searchsorted(cells, torch.arange(ctx.count + 1, dtype=cells.dtype, device=cells.device))
        by_cell = _rows(bar.reshape(-1, bar.shape[-1]), order)
        return torch.segment_reduce(by_cell, "sum", offsets=first, axis=0, initial=0, unsafe=True), None


def _rows(values: Float[Tensor, "M E"], index: Int[Tensor, "*S"]) -> Float[Tensor, "*S E"]:
    """Return `values[index]`; rows of 16 bytes are read as one number each, 50 times faster on a GPU (docs/gpu.md)."""
    if values.device.type == "cpu":
        return values.index_select(0, index.flatten()).view(*index.shape, values.shape[1])
    if values.shape[1] * values.element_size() != 16:
        return values[index]
    numbers = values.contiguous().view(torch.complex128)[:, 0]
    return numbers[index][..., None].view(values.dtype)


@dataclass(frozen=True)
class PathTerrain:
    """Surface normals of the recorded path at its point nearest to the predicted place.

    Reading the normal of row t at step t would give away how far the vehicle went.
    """

    position: Float[Tensor, "B P 2"]  # points of the path relative to each window's start [m]; infinite if none
    normal: Float[Tensor, "B P 3"]  # normals there in the world frame, the same under all wheels; NaN if unknown

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """Return the ground at the predicted place; `t` is not used."""
        squared = (self.position.to(state.dtype) - state[:, None, :2]).square().sum(dim=-1)
        nearest = squared.argmin(dim=1)
        normal = self.normal[torch.arange(len(nearest), device=nearest.device), nearest]
        return Terrain.of(normal[:, None, :].expand(-1, 4, -1))


def on_map(
    dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " B"], batch: Batch
) -> tuple[Batch, TerrainSource]:
    """Return the encoded batch and the terrain source available to a planner.

    The source is the map at the window's start, or the slope of the driven path without maps. With a map, terrain
    before the start is read from it too, so that nothing seen later is used.

    Raises:
        DatasetError: a drive has no map although the dataset has features or other maps, or a window starts without a
            snapshot of it.
    """
    if not windows.dataset.features and not windows.maps.kept:
        return batch, PathTerrain(*windows.path(index))
    if windows.maps.snapped.any() or windows.maps.snapshots_elsewhere:
        lacking = int((~windows.maps.snapped[index]).sum())
        if lacking:
            what = f"{lacking} of {len(index)} windows do not start with a snapshot of the map"
            how = "choose windows of the validation or test part with `windows[windows.evaluation_indices(5)]`"
            raise DatasetError(what, how=how)
    maps, number = windows.maps.of(index)
    if (number < 0).any():
        name = windows.drive_names[windows.drive[index][number < 0][0]]
        raise DatasetError(f"drive '{name}' has no map", how="extract it again")
    numbers = torch.as_tensor(number, device=windows.device)
    source = MapTerrain(maps, numbers, windows.places(index), windows.wheels, dynamics.encoder)
    return with_past_on(source, batch), source


def with_past_on(source: TerrainSource, batch: Batch) -> Batch:
    """Return the batch with its terrain before the start sampled from `source`."""
    past = [source.at(0, state) for state in batch.history.state.unbind(dim=1)]
    rows = Terrain(*(torch.stack(parts, dim=1) for parts in zip(*(vars(t).values() for t in past), strict=True)))
    return replace(batch, history=replace(batch.history, terrain=rows))
