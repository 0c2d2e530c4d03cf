"""Surface normals under the wheels, by feature set."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from offpiste.dataset.array_reader import ArrayReader
from offpiste.dataset.feature_sets import FeatureSetChoice


class NormalsUnderWheels:
    """Surface normals of all drives; those of a map are many, and are read when windows need them.

    Args:
        normals: [D, N, 4, 3] of the drives, in the order of their rows.
        device: where what is read goes.
    """

    def __init__(self, normals: Sequence[np.ndarray], device: torch.device) -> None:
        self._device = device
        self._first = np.cumsum([0, *(n.shape[1] for n in normals)])
        self._readers = [ArrayReader(n) for n in normals]
        self._arrays = normals
        self._sets = normals[0].shape[0]
        self._whole = self.whole() if self._sets == 1 else None

    def whole(self) -> Float[Tensor, "N 4 3"]:
        """Normals of the first feature set at every row."""
        return torch.as_tensor(np.concatenate([n[0] for n in self._arrays]), device=self._device)

    def at(
        self, start: Int[np.ndarray, " B"], count: int, feature_set_choice: FeatureSetChoice
    ) -> Float[Tensor, "B R 4 3"]:
        """Normals at R = `count` rows from `start`; each window lies in one drive."""
        if self._whole is not None:
            rows = torch.as_tensor(start[:, None] + np.arange(count), device=self._device)
            return self._whole[rows]
        found = np.empty((len(start), count, 4, 3), np.float32)
        every = np.empty((self._sets, count, 4, 3), np.float32)
        drive = np.searchsorted(self._first, start, side="right") - 1
        first = (start - self._first[drive]).tolist()
        one = feature_set_choice.flags_only or feature_set_choice.sets.shape[1] == 1
        for window, number in enumerate(drive.tolist()):
            reader = self._readers[number]
            if one:
                chosen = 0 if feature_set_choice.flags_only else int(feature_set_choice.sets[window, 0])
                reader.read(chosen, first[window], found[window])
                continue
            for chosen in np.unique(feature_set_choice.sets[window]).tolist():
                reader.read(chosen, first[window], every[chosen])
            found[window] = every[feature_set_choice.sets[window], np.arange(count)]
        return torch.from_numpy(found).to(self._device)
