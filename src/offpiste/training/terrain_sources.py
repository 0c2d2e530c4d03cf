"""Where a model reads the terrain: under recorded wheels, on a map under predicted ones, or on the driven path."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from offpiste.core.errors import DatasetError
from offpiste.core.state import Terrain, TerrainSource
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.dynamics.kernels.encoder import codes_under_wheels, encode_cells, supports_encoder
from offpiste.mapping.terrain_sampler import MapTerrain


@dataclass(frozen=True)
class PathTerrain:
    """Surface normals of the recorded path at its point nearest to the predicted place.

    Reading row t's normal at step t gives away how far the vehicle went; this does not.

    Attributes:
        position: points of the path relative to each window's start [m]; infinite where there is none.
        normal: surface normals there, in the world frame, the same under all wheels; NaN where unknown.
    """

    position: Float[Tensor, "B P 2"]
    normal: Float[Tensor, "B P 3"]

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """The ground at the predicted place; `t` is not looked at."""
        squared = (self.position.to(state.dtype) - state[:, None, :2]).square().sum(dim=-1)
        nearest = squared.argmin(dim=1)
        normal = self.normal[torch.arange(len(nearest), device=nearest.device), nearest]
        return Terrain.of(normal[:, None, :].expand(-1, 4, -1))


def path_terrain(windows: Windows, index: Int[np.ndarray, " B"]) -> PathTerrain:
    """The path around each window, from 1 s before its start to 8 s after, as far as its drive has valid rows."""
    return PathTerrain(*windows.path(index))


def encoded(dynamics: Dynamics, batch: Batch) -> Batch:
    """The batch with the codes of the recorded ground, as `dynamics` encodes it; each cell is encoded once.

    Raises:
        DatasetError: the model reads features and the dataset has none.
    """
    encoder = dynamics.encoder
    if encoder is None:
        return batch
    if batch.ground is None:
        raise DatasetError(
            "the model reads terrain features and the dataset has none", how="extract with --pca (see fit-pca)"
        )
    features, valid = batch.ground.features, batch.ground.valid
    if isinstance(encoder, Compressor) and supports_encoder(encoder, features):
        codes = encode_cells(encoder, features, valid)
    else:
        codes = encoder(features, valid)
    codes = codes.to(batch.state.dtype)
    past = replace(batch.history.terrain, latent=codes_of_cells(codes, batch.ground.past))
    return replace(
        batch,
        history=replace(batch.history, terrain=past),
        terrain=replace(batch.terrain, latent=codes_of_cells(codes, batch.ground.ahead)),
    )


def codes_of_cells(codes: Float[Tensor, "M E"], cells: Int[Tensor, "*S"]) -> Float[Tensor, "*S E"]:
    """`codes[cells]`; indexing's own gradient adds up in the order in which threads come."""
    if codes.device.type == "cpu" and codes.dtype == torch.float32:
        return codes_under_wheels(codes, cells)
    return _Codes.apply(codes, cells)  # type: ignore[no-untyped-call, no-any-return]


class _Codes(torch.autograd.Function):
    """Codes of cells, and the sum of their adjoints by cell, in the order of `cells`."""

    @staticmethod
    def forward(ctx: Any, codes: Tensor, cells: Tensor) -> Tensor:
        """Codes [*S, E]."""
        ctx.cells, ctx.count = cells, len(codes)
        return _rows(codes, cells)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bar: Tensor) -> tuple[Tensor, None]:
        """Adjoint of the codes."""
        if not ctx.cells.numel():
            return bar.new_zeros(ctx.count, bar.shape[-1]), None
        cells, order = torch.sort(ctx.cells.flatten().int(), stable=True)  # half the bits are sorted in half the time
        first = torch.searchsorted(cells, torch.arange(ctx.count + 1, dtype=cells.dtype, device=cells.device))
        by_cell = _rows(bar.reshape(-1, bar.shape[-1]), order)
        return torch.segment_reduce(by_cell, "sum", offsets=first, axis=0, initial=0, unsafe=True), None


def _rows(values: Float[Tensor, "M E"], index: Int[Tensor, "*S"]) -> Float[Tensor, "*S E"]:
    """`values[index]`; rows of 16 bytes are read as one number each, a fiftieth of the time on a GPU (docs/gpu.md)."""
    if values.shape[1] * values.element_size() != 16:
        return values[index]
    numbers = values.contiguous().view(torch.complex128)[:, 0]
    return numbers[index][..., None].view(values.dtype)


def on_map(
    dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " B"], batch: Batch
) -> tuple[Batch, TerrainSource]:
    """The ground where predictions go, as a planner reads it: on the map, or without any the slope of the driven path.

    What lay under the wheels before the start comes from the map as well: hindsight knows more than the vehicle did.

    Args:
        batch: of the same windows, encoded.

    Returns:
        the batch, its past read on the map, and the source of what lies ahead.

    Raises:
        DatasetError: a drive has no map, though the dataset has features or maps of others, or a window does not start
            with a snapshot of it.
    """
    if not windows.dataset.features and not windows.maps.kept:
        return batch, path_terrain(windows, index)
    source = map_terrain(dynamics, windows, index)
    return with_past_on(source, batch), source


def map_terrain(dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " B"]) -> MapTerrain:
    """The maps of windows, read under wheels and encoded by a model.

    Raises:
        DatasetError: a drive has no map, or a window does not start with a snapshot of it.
    """
    if windows.maps.snapped.any() or windows.maps.snapshots_elsewhere:
        _refuse_without_snapshot(windows, index)
    maps, number = windows.maps.of(index)
    if (number < 0).any():
        name = windows.drive_names[windows.drive[index][number < 0][0]]
        raise DatasetError(f"drive '{name}' has no map", how="extract it again")
    return MapTerrain(
        maps,
        torch.as_tensor(number, device=windows.device),
        windows.places(index),
        windows.wheels,
        dynamics.encoder,
    )


def _refuse_without_snapshot(windows: Windows, index: Int[np.ndarray, " B"]) -> None:
    lacking = int((~windows.maps.snapped[index]).sum())
    if lacking:
        what = f"{lacking} of {len(index)} windows do not start with a snapshot of the map"
        how = "choose among all windows of the validation or test part with `windows[windows.evaluation_indices(5)]`"
        raise DatasetError(what, how=how)


def with_past_on(source: TerrainSource, batch: Batch) -> Batch:
    """The batch, with what lay under the wheels before its start as a source has it."""
    past = [source.at(0, state) for state in batch.history.state.unbind(dim=1)]
    rows = Terrain(
        torch.stack([t.normal for t in past], dim=1),
        torch.stack([t.known for t in past], dim=1),
        torch.stack([t.latent for t in past], dim=1),
    )
    return replace(batch, history=replace(batch.history, terrain=rows))
