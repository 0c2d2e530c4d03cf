"""Features of the ground under the wheels, stored once a cell instead of once a row."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float16, Float32, Int, Int32
from torch import Tensor


@dataclass(frozen=True)
class Cells:
    """Ground cells that the wheels of a drive touched, numbered by first visit.

    Attributes:
        index: cell under each wheel at each row; -1 where the map has none.
        features: by feature set.
        valid: whether a cell has features in a set.
        distance: from sensor to point when they were observed [m]; NaN where unknown.
        elevation: of the ground [m]; NaN where unknown.
    """

    index: Int32[np.ndarray, "N 4"]
    features: Float16[np.ndarray, "D M F"]
    valid: Bool[np.ndarray, "D M"]
    distance: Float32[np.ndarray, "D M"]
    elevation: Float32[np.ndarray, "D M"]


@dataclass(frozen=True)
class UnderWheels:
    """Features of the ground cells that a batch of windows touches, each once.

    Attributes:
        features: of the cells; the last one is the cell that is not there.
        valid: whether a cell has features.
        past: number of the cell under each wheel at rows t-10 ... t-1.
        ahead: the same at rows t ... t+T-1.
    """

    features: Float[Tensor, "M F"]
    valid: Bool[Tensor, " M"]
    past: Int[Tensor, "B H 4"]
    ahead: Int[Tensor, "B T 4"]


class CellTable:
    """The cells of all drives in one table, and a last one that is not there."""

    def __init__(self, cells: list[Cells], device: torch.device, feature_set: int = 0) -> None:
        sizes = [c.features.shape[1] for c in cells]
        first, missing = np.cumsum([0, *sizes[:-1]]), sum(sizes)
        index = [np.where(c.index < 0, missing, c.index + n) for c, n in zip(cells, first, strict=True)]
        self._index = torch.as_tensor(np.concatenate(index), device=device)
        features = np.concatenate([c.features[feature_set] for c in cells])
        valid = np.concatenate([c.valid[feature_set] for c in cells])
        self._features = torch.as_tensor(np.pad(features, ((0, 1), (0, 0)), constant_values=np.nan), device=device)
        self._valid = torch.as_tensor(np.pad(valid, (0, 1)), device=device)

    def under(self, past: Int[Tensor, "B H"], ahead: Int[Tensor, "B T"]) -> UnderWheels:
        """What lies under the wheels at rows."""
        before, after = self._index[past], self._index[ahead]
        touched = torch.zeros(len(self._valid), dtype=torch.bool, device=self._valid.device)
        touched[before.flatten()] = True
        touched[after.flatten()] = True
        touched[-1] = True
        number = touched.cumsum(0) - 1
        return UnderWheels(self._features[touched].float(), self._valid[touched], number[before], number[after])

    def at(self, rows: Int[Tensor, " n"]) -> tuple[Float[Tensor, "M F"], Bool[Tensor, " M"]]:
        """Features and validity of all wheels at rows."""
        cells = self._index[rows].flatten()
        return self._features[cells].float(), self._valid[cells]
