"""True ground properties of a simulator as features: an upper bound for any camera."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch

from offpiste.core.errors import LogError
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.resample import Rows
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES, read_truth_map
from offpiste.mapping.terrain_map import TerrainMap, wheel_positions
from offpiste.mapping.terrain_sampler import sample_maps, stack_maps
from offpiste.rig.rig import Rig

REACH = 75.0  # reach of a prediction of 5 s around the driven path [m]

FeatureSource = Literal["none", "ground-truth", "ground-kind"]

LAYERS: dict[FeatureSource, tuple[str, ...]] = {
    "none": (),
    "ground-truth": GROUND_PROPERTIES,
    "ground-kind": (*GROUND_KINDS, "wetness"),
}
"""Layers of a simulator's map used as features: tyre properties, or the kind of ground. The kind is a placebo
where all kinds drive alike."""


class Grounded(NamedTuple):
    """Rows with the true ground under their wheels, and its map."""

    rows: Rows
    map: TerrainMap


def truth_map(log: str | Path, names: Sequence[str]) -> TerrainMap:
    """Read elevation and layers of the true map in a simulated log; raise `LogError` if it lacks one."""
    result = read_truth_map(log)
    if missing := [name for name in ("elevation", *names) if name not in result.layers]:
        how = "record it again with `offpiste simulate`"
        raise LogError(f"its true map has no layer '{missing[0]}'", where=log, how=how)
    features = np.stack([result.layers[name] for name in names], axis=-1)
    return TerrainMap(np.array(result.origin), result.resolution, result.layers["elevation"], features)


def with_ground_truth(rows: Rows, truth: TerrainMap, rig: Rig) -> Grounded:
    """Return rows with the true normals and features under the wheels of a level vehicle, as in predictions."""
    xy = rows.world_xy
    known = np.isfinite(xy).all(axis=1)
    low, high = xy[known].min(axis=0) - REACH, xy[known].max(axis=0) + REACH
    ground = truth.cropped(low, high)
    ground = replace(ground, features=ground.features.astype(np.float16))
    ny, nx = ground.elevation.shape

    places = wheel_positions(np.where(known[:, None], xy, np.inf), rows.state[:, 2], rig.wheel_positions())
    result = sample_maps(
        stack_maps([ground]),
        torch.zeros(places.shape[:2], dtype=torch.long),
        torch.as_tensor(np.where(np.isfinite(places), places, np.inf) - rows.origin),
        torch.as_tensor(np.broadcast_to(rows.origin, places.shape).copy()),
    )
    column, row = np.moveaxis(np.round((np.nan_to_num(places) - ground.origin) / ground.resolution), -1, 0).astype(int)
    cell = np.clip(row, 0, ny - 1) * nx + np.clip(column, 0, nx - 1)
    valid = result.valid.numpy()
    visited, first, index = np.unique(cell[valid], return_index=True, return_inverse=True)
    order = np.argsort(first)
    under = np.full(places.shape[:2], -1, np.int32)
    under[valid] = np.argsort(order)[index]
    features = ground.features.reshape(ny * nx, -1)[visited[order]]
    elevation = ground.elevation.reshape(-1)[visited[order]].astype(np.float32)
    seen = np.ones((1, len(features)), bool)
    cells = Cells(under, features[None], seen, np.zeros(seen.shape, np.float32), elevation[None])
    normal = torch.where(result.known[..., None], result.normal, torch.nan).numpy().astype(np.float32)[None]
    return Grounded(replace(rows, normal=normal, cells=cells), ground)
