"""Features of other ground: what is left of a gain when they are read 50 m further along the path.

The shifted features look like those of any ground, as often missing at each distance, but say nothing of the ground
driven on. What is left of the gain does not come from knowing the ground.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, Int

from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics
from offpiste.evaluation.evaluated_models import Reading
from offpiste.mapping.terrain_sampler import MapTerrain
from offpiste.reproduction.gains import HINDSIGHT, MAP, Gain, errors_of, evaluation_index, gain, same_windows
from offpiste.state import Terrain, TerrainSource
from offpiste.training.run import Run
from offpiste.training.terrain_sources import map_terrain, on_map, with_past_on

METRES: Final = 50.0
"""Patches of ground are 8 to 25 m long (`simulation.ground.PATCH_GRAIN`): so far on lies another one."""

READINGS: Final[tuple[Reading, ...]] = (MAP, HINDSIGHT, *(("recorded", name) for name in ("10", "20", "30", "40")))

ABOUT_SHIFT: Final = (
    f"As recorded, and with features from {METRES:.0f} m further along the driven path (normals stay). 95 % intervals, "
    "baseline b. On the map, features come from the map of the window that starts there, laid "
    "where this one's is."
)


def shift_gains(
    dataset: Dataset,
    runs: Mapping[str, Sequence[Run]],
    *,
    stride: int,
    scale: torch.Tensor,
    kept: Path,
) -> list[Gain]:
    """Gains over `b` with features as recorded and from elsewhere, on the map and at recorded places of the test part.

    Args:
        runs: of `b` and of models that read features.
        stride: of the windows at recorded places [rows].
        scale: of the loss.
        kept: folder of the errors.
    """
    windows, elsewhere = Windows(dataset, "test"), Windows(shifted(dataset, METRES), "test")
    gains: list[Gain] = []
    for reading in READINGS:
        index = evaluation_index(windows, reading, stride)
        if reading == MAP and not len(index):
            continue
        blind = [errors_of(run, windows, index, reading, scale=scale, kept=kept) for run in runs["b"]]
        other, source = (windows, ShiftedMap(windows, METRES)) if reading == MAP else (elsewhere, on_map)
        there = same_windows(windows, index, other)
        for model in (name for name in runs if name != "b"):
            mine = [errors_of(run, windows, index, reading, scale=scale, kept=kept) for run in runs[model]]
            moved = [
                errors_of(run, other, there, reading, scale=scale, kept=kept / "shifted", map_source=source)
                for run in runs[model]
            ]
            gains += [gain("as recorded", model, mine, blind, reading), gain("shifted", model, moved, blind, reading)]
    return gains


def shifted(dataset: Dataset, metres: float) -> Dataset:
    """The dataset with the features of each row those of the ground so much further along the driven path."""
    # Windows are selected by their own ground, before, on the dataset itself.
    return replace(dataset, drives=tuple(_shifted(drive, metres) for drive in dataset.drives), min_hindsight=0.0)


def _shifted(drive: StoredDrive, metres: float) -> StoredDrive:
    cells = drive.rows.cells
    assert cells is not None
    index = cells.index[further(drive.rows.state[:, :2], metres)]
    return replace(drive, rows=replace(drive.rows, cells=replace(cells, index=index)))


def further(position: Float[np.ndarray, "N 2"], metres: float) -> Int[np.ndarray, " N"]:
    """For each row, the row so much further along the path; where it ends before, as much further back."""
    steps = np.hypot(*np.diff(position.astype(np.float64), axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(np.nan_to_num(steps))))
    wanted = np.where(along + metres <= along[-1], along + metres, along - metres)
    return np.searchsorted(along, wanted).clip(0, len(along) - 1)


class ShiftedMap:
    """The ground of windows with the features of other windows' maps, for `evaluation.evaluate.predict`.

    Args:
        windows: that have maps.
        metres: how much further along the path the other window starts, about: snapshots are some metres apart.
    """

    def __init__(self, windows: Windows, metres: float) -> None:
        mapped = np.flatnonzero(windows.maps.snapped) if windows.maps.snapped.any() else np.arange(len(windows))
        self._other = np.full(len(windows), -1)
        for drive in np.unique(windows.drive[mapped]):
            mine = mapped[windows.drive[mapped] == drive]
            self._other[mine] = mine[further(windows.places(mine).cpu().numpy(), metres)]

    def __call__(
        self, dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " B"], batch: Batch
    ) -> tuple[Batch, TerrainSource]:
        """The batch and its ground; features are read where the other window's map has what lies likewise ahead.

        Models that hold the features of the start read them along the path here.
        """
        other = self._other[index]
        start = windows.gather(other).state
        source = _OtherFeatures(
            map_terrain(dynamics, windows, index),
            map_terrain(dynamics, windows, other),
            batch.state[:, :3],
            start[:, :3],
        )
        return with_past_on(source, batch), source


@dataclass(frozen=True)
class _OtherFeatures:
    """Normals of one map; features of another, which lies turned and moved so that the windows' starts fall together.

    Attributes:
        start, other_start: px, py [m], yaw [rad] of the windows' starts, each in its own frame.
    """

    own: MapTerrain
    other: MapTerrain
    start: Float[torch.Tensor, "B 3"]
    other_start: Float[torch.Tensor, "B 3"]

    def at(self, t: int, state: Float[torch.Tensor, "B 6"]) -> Terrain:
        turn = self.other_start[:, 2] - self.start[:, 2]
        cos, sin = torch.cos(turn), torch.sin(turn)
        x, y = (state[:, :2] - self.start[:, :2]).unbind(-1)
        place = self.other_start[:, :2] + torch.stack((cos * x - sin * y, sin * x + cos * y), dim=-1)
        moved = torch.cat((place, (state[:, 2] + turn)[:, None], state[:, 3:]), dim=-1)
        return replace(replace(self.own, encode=None).at(t, state), latent=self.other.at(t, moved).latent)
