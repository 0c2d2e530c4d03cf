"""Tables of features and normals that windows read: on the device if they fit, else from disk."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Int

from offpiste.dataset.feature_sets import FeatureSetChoice
from offpiste.dataset.features_under_wheels import (
    Cells,
    CellTable,
    FeaturesUnderWheels,
    NormalsUnderWheels,
    joined_index,
    rows_from,
)
from offpiste.dataset.store import Dataset


class ResidentCells:
    """`CellTable` with all cells resident on the device."""

    def __init__(self, cells: Sequence[Cells], device: torch.device) -> None:
        index, first = joined_index(cells)
        self._index = torch.from_numpy(index.astype(np.int64)).to(device)
        self._valid = torch.from_numpy(np.concatenate([c.valid for c in cells], axis=1)).to(device)
        self.sets, _, channels = cells[0].features.shape
        self._features = torch.empty(self.sets, int(first[-1]), channels, dtype=torch.float16, device=device)
        for c, begin, end in zip(cells, first[:-1], first[1:], strict=True):
            self._features[:, begin:end] = torch.from_numpy(np.array(c.features))

    def under(
        self, start: Int[np.ndarray, " B"], count: int, feature_set_choice: FeatureSetChoice, history: int = 0
    ) -> FeaturesUnderWheels:
        """Return features of the cells under the wheels (`CellTable.under`)."""
        device, (_, cells, channels) = self._features.device, self._features.shape
        cell = self._index[rows_from(start, count, device)]
        chosen = torch.from_numpy(np.ascontiguousarray(feature_set_choice.features)).to(device)[..., None]
        nowhere = self.sets * cells
        key = torch.where(cell >= 0, chosen * cells + cell, nowhere)
        # Marks and a running count avoid the sorting of torch.unique.
        touched = torch.zeros(nowhere + 1, dtype=torch.bool, device=device)
        touched[key] = True
        touched[nowhere] = True
        under = touched.cumsum(0, dtype=torch.int32)[key].long() - 1
        distinct = touched[:-1].nonzero()[:, 0]
        from_set, place = torch.div(distinct, cells, rounding_mode="floor"), distinct % cells
        valid, features = self._valid[from_set, place], self._features[from_set, place].float()
        features = torch.cat((features, features.new_full((1, channels), torch.nan)))
        return FeaturesUnderWheels(
            features, torch.cat((valid, valid.new_zeros(1))), under[:, :history], under[:, history:]
        )


@dataclass(frozen=True)
class GroundTables:
    """Ground of a dataset, which several `Windows` may share; no cells in datasets without features."""

    cells: CellTable | ResidentCells | None
    normals: NormalsUnderWheels


def ground_tables(dataset: Dataset, device: torch.device, budget: int = 0) -> GroundTables:
    """Return the ground for batches on a device; tables of more than `budget` bytes are read from disk."""
    rows = [drive.rows for drive in dataset.drives]
    normals = [r.normal for r in rows]
    cells = [r.cells for r in rows if r.cells is not None] if dataset.features else []
    arrays = [*normals, *(array for c in cells for array in (c.features, c.valid, c.index, c.index))]  # 64-bit numbers
    resident = sum(array.nbytes for array in arrays) <= budget
    table = (ResidentCells if resident else CellTable)(cells, device) if cells else None
    return GroundTables(table, NormalsUnderWheels(normals, device, resident=resident))


def free_budget(device: torch.device) -> int:
    """Return the bytes for `ground_tables`: half of the free memory of a GPU, none on the CPU."""
    return torch.cuda.mem_get_info(device)[0] // 2 if device.type == "cuda" else 0
