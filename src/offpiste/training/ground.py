"""Where a model reads the ground: under the recorded wheels, or on a map under the wheels that it predicts."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Int

from offpiste.dataset.path_terrain import path_terrain
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics, Hybrid
from offpiste.dynamics.encoder import FeatureEncoder
from offpiste.errors import DatasetError
from offpiste.mapping.lookup import HeldCodes, MapTerrain
from offpiste.trajectory import Terrain, TerrainSource


def encoder_of(dynamics: Dynamics) -> FeatureEncoder | None:
    """The encoder of a model that reads terrain features."""
    return dynamics.encoder if isinstance(dynamics, Hybrid) else None


def encoded(dynamics: Dynamics, batch: Batch) -> Batch:
    """The batch with the codes of the recorded ground, as `dynamics` encodes it; each cell is encoded once.

    Raises:
        DatasetError: the model reads features and the dataset has none.
    """
    encoder = encoder_of(dynamics)
    if encoder is None:
        return batch
    if batch.ground is None:
        raise DatasetError(
            "the model reads terrain features and the dataset has none", how="extract with --pca (see fit-pca)"
        )
    codes = encoder(batch.ground.features, batch.ground.valid).to(batch.state.dtype)
    ahead = batch.ground.ahead
    if isinstance(dynamics, Hybrid) and dynamics.holds:
        ahead = ahead[:, :1].expand_as(ahead)
    past = Terrain(batch.history.terrain.normal, codes[batch.ground.past])
    return replace(
        batch,
        history=replace(batch.history, terrain=past),
        terrain=Terrain(batch.terrain.normal, codes[ahead]),
    )


def on_map(
    dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " B"], batch: Batch
) -> tuple[Batch, TerrainSource]:
    """The ground where predictions go, as a planner reads it: on the map, or else the slope of the driven path.

    What lay under the wheels before the start comes from the map as well: hindsight knows more than the vehicle did.

    Args:
        batch: of the same windows, encoded.

    Returns:
        the batch, its past read on the map, and the source of what lies ahead.

    Raises:
        DatasetError: a drive has no map.
    """
    if not windows.maps.any:
        return batch, path_terrain(windows, index)
    source = map_terrain(dynamics, windows, index)
    batch = with_past_on(source, batch)
    held = isinstance(dynamics, Hybrid) and dynamics.holds
    return batch, HeldCodes.of(source, batch.state) if held else source


def map_terrain(dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " B"]) -> MapTerrain:
    """The maps of windows, read under wheels and encoded by a model.

    Raises:
        DatasetError: a drive has no map.
    """
    maps, number = windows.maps.of(index)
    if (number < 0).any():
        name = windows.drive_names[windows.drive[index][number < 0][0]]
        raise DatasetError(f"drive '{name}' has no map", how="extract it again")
    return MapTerrain(
        maps,
        torch.as_tensor(number, device=windows.device),
        windows.places(index),
        windows.wheels,
        encoder_of(dynamics),
    )


def with_past_on(source: TerrainSource, batch: Batch) -> Batch:
    """The batch, with what lay under the wheels before its start as a source has it."""
    past = [source.at(0, state) for state in batch.history.state.unbind(dim=1)]
    known = Terrain(torch.stack([t.normal for t in past], dim=1), torch.stack([t.latent for t in past], dim=1))
    return replace(batch, history=replace(batch.history, terrain=known))
