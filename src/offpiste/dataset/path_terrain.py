"""The slope of the driven path read where a prediction goes, not where the vehicle went: a map of one line."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from offpiste.dataset.windows import Windows
from offpiste.trajectory import Terrain


@dataclass(frozen=True)
class PathTerrain:
    """Normals of the recorded path, read at its point nearest to the predicted place.

    Reading row t's normal at step t tells a model how far the vehicle went (DESIGN.md, "Leak"); this does not.

    Attributes:
        position: points of the path relative to each window's start [m]; infinite where there is none.
        normal: surface normals there, in the world frame, the same under all wheels.
    """

    position: Float[Tensor, "B P 2"]
    normal: Float[Tensor, "B P 3"]

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """The ground at the predicted place; `t` is not looked at."""
        squared = (self.position.to(state.dtype) - state[:, None, :2]).square().sum(dim=-1)
        nearest = squared.argmin(dim=1)
        normal = self.normal[torch.arange(len(nearest), device=nearest.device), nearest]
        under_wheels = normal[:, None, :].expand(-1, 4, -1)
        return Terrain(under_wheels, under_wheels[..., :0])


def path_terrain(windows: Windows, index: Int[np.ndarray, " B"]) -> PathTerrain:
    """The path around each window, from 1 s before its start to 8 s after, as far as its drive has valid rows."""
    return PathTerrain(*windows.path(index))
