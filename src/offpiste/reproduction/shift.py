"""Control with features of other ground: the gain that remains if features are read at least 50 m away.

Shifted features have the same statistics but no information about the ground driven on, so that the remaining gain does
not come from knowing the ground. Windows without ground that far away are left out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import torch
from jaxtyping import Float, Int

from offpiste.core.conventions import HISTORY_STEPS
from offpiste.core.state import Terrain, TerrainSource
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Dynamics
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.intervals import MIN_UNITS, Sampling
from offpiste.mapping.terrain_sampler import MapTerrain
from offpiste.reproduction.results import HINDSIGHT, MAP, Gain, errors_of, gain, same_windows
from offpiste.reproduction.runs import evaluation_windows
from offpiste.training.prediction import map_terrain, with_past_on
from offpiste.training.run import Run

METRES: Final = 50.0
"""Smallest distance to other ground [m]; patches of ground are 8 to 25 m long (`simulation.ground.PATCH_GRAIN`)."""

READINGS: Final[tuple[Reading, ...]] = (MAP, HINDSIGHT, *(("recorded", name) for name in ("10", "20", "30", "40")))

SHIFTED, OWN_GROUND = "shifted", "as recorded against shifted"
"""Cases besides "as recorded": shifted features against `b`, and recorded against shifted features."""


class OtherGround(msgspec.Struct, frozen=True, kw_only=True):
    """Distance of the other ground for the windows of a terrain lookup.

    Attributes:
        windows: number of evaluated windows.
        used: number of windows with other ground.
        blocks: number of blocks of 10 s with such windows.
        metres: smallest, median and largest straight-line distance; NaN without any.
    """

    lookup: str
    windows: int
    used: int
    blocks: int
    metres: tuple[float, float, float]

    @property
    def enough(self) -> bool:
        """Whether there are enough blocks for an interval."""
        return self.blocks >= MIN_UNITS

    def line(self, wanted: float) -> str:
        """Return a line of text."""
        where = "on the map" if self.lookup == "map" else "at recorded places"
        used = f"{self.used} of {self.windows} windows {where} have ground at least {wanted:.0f} m away"
        if not self.enough:
            return f"{where}: none, since only {used}, in {self.blocks} blocks of 10 s: drive farther"
        least, median, most = self.metres
        return f"{used} ({least:.0f} to {most:.0f} m, median {median:.0f} m)"


@dataclass(frozen=True)
class ShiftControl:
    """Gains with features of other ground.

    Attributes:
        gains: for each terrain lookup and model, over `b` with features as recorded and `SHIFTED`, and of the first
            over the second (`OWN_GROUND`); lookups with too few windows are left out.
        ground: for each terrain lookup.
    """

    gains: list[Gain]
    ground: list[OtherGround]
    metres: float = METRES

    @property
    def about(self) -> str:
        """Description of the gains and the distance of the other ground."""
        return (
            f"As recorded, and with features of ground at least {self.metres:.0f} m away on the driven path, ahead or "
            "else behind (normals stay). 95 % intervals; baseline b, or the model itself with shifted features. On the "
            "map, features come from the map of the window that starts there, aligned with this window's start. "
            f"{'; '.join(one.line(self.metres) for one in self.ground)}."
        )


def shift_gains(
    dataset: Dataset,
    runs: Mapping[str, Sequence[Run]],
    *,
    stride: int,
    scale: torch.Tensor,
    kept: Path,
    metres: float = METRES,
) -> ShiftControl:
    """Compute gains over `b` with recorded and shifted features, on the map and at recorded places of the test part.

    Args:
        runs: of `b` and of models that read features.
        stride: rows between windows at recorded places.
        scale: units of the loss.
        kept: folder of the errors.
        metres: smallest straight-line distance of the other ground [m].
    """
    windows, elsewhere = Windows(dataset, "test"), Windows(shifted(dataset, metres), "test")
    gains: list[Gain] = []
    ground: dict[str, OtherGround] = {}
    for reading in READINGS:
        index = evaluation_windows(windows, reading, stride)
        if reading == MAP and not (len(index) and windows.maps.any):
            continue
        moved_map = ShiftedMap(windows, metres) if reading == MAP else None
        away = moved_map.away(index) if moved_map else away_along(windows, index, metres)
        far = np.flatnonzero(np.isfinite(away))
        lookup = str(reading[0])
        ground.setdefault(lookup, _described(lookup, windows, index, away))
        if not ground[lookup].enough:
            continue
        blind = [errors_of(run, windows, index, reading, scale=scale, kept=kept).take(far) for run in runs["b"]]
        other = windows if moved_map else elsewhere
        there, folder = same_windows(windows, index[far], other), kept / "other ground"
        for model in (name for name in runs if name != "b"):
            mine, moved = (
                [errors_of(run, windows, index, reading, scale=scale, kept=kept).take(far) for run in runs[model]],
                [
                    errors_of(run, other, there, reading, scale=scale, kept=folder, map_source=moved_map)
                    for run in runs[model]
                ],
            )
            gains += [gain("as recorded", model, mine, blind, reading), gain(SHIFTED, model, moved, blind, reading)]
            gains.append(gain(OWN_GROUND, model, mine, moved, reading, baseline=f"{model}, shifted"))
    return ShiftControl(gains, list(ground.values()), metres)


@dataclass(frozen=True)
class _Starts:
    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]


def _described(
    lookup: str, windows: Windows, index: Int[np.ndarray, " n"], away: Float[np.ndarray, " n"]
) -> OtherGround:
    far = np.isfinite(away)
    starts = _Starts(windows.drive[index[far]], windows.row_in_drive(index[far]))
    spread = (
        (float(away[far].min()), float(np.median(away[far])), float(away[far].max())) if far.any() else (np.nan,) * 3
    )
    blocks = Sampling().on(starts).blocks if far.any() else 0
    return OtherGround(lookup=lookup, windows=len(index), used=int(far.sum()), blocks=blocks, metres=spread)


def shifted(dataset: Dataset, metres: float) -> Dataset:
    """Return the dataset with the features of ground that far away in each row; missing where there is none."""
    # Windows are selected on the dataset itself.
    return replace(dataset, drives=tuple(_shifted(drive, metres) for drive in dataset.drives), min_hindsight=0.0)


def _shifted(drive: StoredDrive, metres: float) -> StoredDrive:
    cells = drive.rows.cells
    assert cells is not None
    row = other_ground(drive.rows.state[:, :2], metres)
    index = np.where(row[:, None] >= 0, cells.index[row], -1).astype(cells.index.dtype)
    return replace(drive, rows=replace(drive.rows, cells=replace(cells, index=index)))


def other_ground(position: Float[np.ndarray, "N 2"], metres: float) -> Int[np.ndarray, " N"]:
    """Return for each row the first row ahead at that straight-line distance, else the last one behind.

    -1 if there is neither, or no position.
    """
    known = np.flatnonzero(np.isfinite(position).all(axis=1))
    path = position[known].astype(np.float64)
    ahead, behind = _first_ahead(path, metres), _first_ahead(path[::-1], metres)[::-1]
    found = np.where(ahead >= 0, ahead, np.where(behind >= 0, len(path) - 1 - behind, -1))
    result = np.full(len(position), -1)
    result[known] = np.where(found >= 0, known[found], -1)
    return result


def _first_ahead(path: Float[np.ndarray, "N 2"], metres: float) -> Int[np.ndarray, " N"]:
    """Sphere tracing: no point within the missing distance along the path can be far enough."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
    result = np.full(len(path), -1)
    row = at = np.arange(len(path))
    while len(row):
        lacking = metres - np.hypot(*(path[at] - path[row]).T)
        result[row[lacking <= 0]] = at[lacking <= 0]
        row, at, lacking = row[lacking > 0], at[lacking > 0], lacking[lacking > 0]
        at = np.maximum(np.searchsorted(along, along[at] + lacking), at + 1)
        row, at = row[at < len(path)], at[at < len(path)]
    return result


def away_along(windows: Windows, index: Int[np.ndarray, " n"], metres: float) -> Float[np.ndarray, " n"]:
    """Return the distance of the ground that `shifted` gives the starts of windows [m]; NaN if a row has none."""
    result, span = np.full(len(index), np.nan), np.arange(-HISTORY_STEPS, windows.horizon)
    for number in np.unique(windows.drive[index]):
        position = windows.dataset.drives[number].rows.state[:, :2].astype(np.float64)
        other, mine = other_ground(position, metres), np.flatnonzero(windows.drive[index] == number)
        row = windows.row_in_drive(index[mine])
        away = np.hypot(*(position[other[row]] - position[row]).T)
        result[mine] = np.where((other[row[:, None] + span] >= 0).all(axis=1), away, np.nan)
    return result


class ShiftedMap:
    """Map source (`training.prediction.MapSource`) with the features of other windows' maps.

    Args:
        windows: with maps.
        metres: smallest distance of the other window's start (`other_ground`).
    """

    def __init__(self, windows: Windows, metres: float) -> None:
        mapped = np.flatnonzero(windows.maps.snapped) if windows.maps.snapped.any() else np.arange(len(windows))
        self._other, self._windows = np.full(len(windows), -1), windows
        for drive in np.unique(windows.drive[mapped]):
            mine = mapped[windows.drive[mapped] == drive]
            other = other_ground(windows.places(mine).cpu().numpy(), metres)
            self._other[mine] = np.where(other >= 0, mine[other], -1)

    def away(self, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the distance of the other windows' starts [m]; NaN if there is none."""
        other = self._other[index]
        there, here = (self._windows.places(each).cpu().numpy() for each in (other, index))
        return np.where(other >= 0, np.hypot(*(there - here).T), np.nan)

    def __call__(
        self, dynamics: Dynamics, windows: Windows, index: Int[np.ndarray, " B"], batch: Batch
    ) -> tuple[Batch, TerrainSource]:
        """Return the batch and its ground, with features from the same relative place of the other window's map."""
        other = self._other[index]
        assert (other >= 0).all(), "windows without other ground"
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
    """Normals of one map with features of another, aligned so that the windows' starts coincide.

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
