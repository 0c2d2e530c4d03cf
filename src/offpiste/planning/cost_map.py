"""Map layers that cost terms read (hazard, speed limit, course …), as one grid of cells."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.mapping.terrain_map import TerrainLayers, on_map
from offpiste.planning.costs.layers import CostLayer, Hazards, computed, layer_sources
from offpiste.planning.course import Course, Goal


@dataclass(frozen=True)
class CostMap:
    """Layers at cell centres; row j lies at y = origin[1] + j resolution, column i at x = origin[0] + i resolution.

    Attributes:
        origin: centre of cell [0, 0] in the world frame [m] (float64).
        resolution: size of a cell [m].
        layers: never NaN; speed limits may be infinite.
        outside: value of each layer off the map; NaN for the value of the nearest cell.
        table: declarations of the layers, in their order.
    """

    origin: Float[Tensor, " 2"]
    resolution: float
    layers: Float[Tensor, "ny nx C"]
    outside: tuple[float, ...]
    table: tuple[CostLayer, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the layers."""
        return tuple(layer.name for layer in self.table)

    def at(self, place: Float[Tensor, "*P 2"], offset: Float[Tensor, " 2"]) -> Float[Tensor, "*P C"]:
        """Values of the layers in the nearest cell; off the map those of `outside`.

        Layers that are read at the pose point are NaN where the place is not finite.

        Args:
            place: x, y [m].
            offset: of the frame of `place` in the world frame [m] (float64).
        """
        ny, nx, _ = self.layers.shape
        cell = (place + (offset - self.origin).to(place.dtype)) * (1 / self.resolution)
        limit = cell.new_tensor([nx - 1, ny - 1])
        inside = on_map(cell[..., 0], cell[..., 1], nx - 1, ny - 1, 0.5)
        nearest = torch.minimum(cell.nan_to_num().clamp(min=0), limit).round().long()
        values = self.layers[nearest[..., 1], nearest[..., 0]].to(place.dtype)
        for column, (layer, outside) in enumerate(zip(self.table, self.outside, strict=True)):
            if not math.isnan(outside):
                values[..., column] = torch.where(inside, values[..., column], outside)
            if layer.read == "pose point":
                values[..., column] += (place - place).sum(dim=-1)
        return values


def cost_map(ground: TerrainLayers, course: Course | Goal, hazards: Hazards) -> CostMap:
    """Cost map of all declared layers, on the grid of the terrain map."""
    sources = layer_sources()
    inputs = {"ground": ground, "course": course, "hazards": hazards}
    layers = np.concatenate([computed(source, inputs) for source in sources], -1, dtype=np.float32)
    table = tuple(layer for source in sources for layer in source.layers)
    return CostMap(
        torch.as_tensor(ground.origin, dtype=torch.float64),
        ground.resolution,
        torch.from_numpy(layers),
        tuple(_outside(layer, hazards) for layer in table),
        table,
    )


def _outside(layer: CostLayer, hazards: Hazards) -> float:
    if layer.outside is None:
        return math.nan
    return layer.outside(hazards) if callable(layer.outside) else layer.outside
