"""Windows of 5 s: (drive, row) pairs into the rows of a dataset, gathered into batches."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from offpiste.core.conventions import DT, HISTORY_STEPS, HORIZON_STEPS
from offpiste.core.errors import DatasetError
from offpiste.core.state import History, Terrain, wrap_angle
from offpiste.dataset.columns import COLUMNS, Segment
from offpiste.dataset.feature_sets import FeatureSetChoice, same_feature_set, set_number
from offpiste.dataset.features_under_wheels import FeaturesUnderWheels
from offpiste.dataset.ground_tables import GroundTables, ground_tables
from offpiste.dataset.resample import OWN_COLUMNS
from offpiste.dataset.splits import part_number
from offpiste.dataset.store import Dataset
from offpiste.dataset.window_maps import WindowMaps
from offpiste.dataset.window_starts import evaluation_starts, no_window

UNIT_TOLERANCE = 1e-3  # largest deviation of a stored normal's squared length from 1


MOTION: Final = ("state", "state_causal", "actuators", "actuators_causal", "control", "control_causal")
"""Columns of states, actuators and controls, without the ground."""


@dataclass(frozen=True)
class Batch:
    """Batch of windows. Positions are relative to each window's start; yaw there lies in [-pi, pi]."""

    history: History  # rows t-10 ... t-1
    state: Float[Tensor, "B 6"]  # at row t, where predictions start
    actuators: Float[Tensor, "B A"]
    control: Float[Tensor, "B T U"]  # rows t ... t+T-1
    terrain: Terrain  # recorded, rows t ... t+T-1, without codes yet
    target: Float[Tensor, "B T 6"]  # rows t+1 ... t+T
    target_actuators: Float[Tensor, "B T A"]
    ground: FeaturesUnderWheels | None = None  # under the recorded wheels; None in datasets without features
    extra: Mapping[str, Mapping[Segment, Tensor]] = field(default_factory=dict)  # of the other columns of `COLUMNS`


class Windows:
    """Windows of one part of a dataset that start above a speed; `DatasetError` if there are none.

    Args:
        part: "train", "validation" or "test".
        start: "causal" for starts and histories as known at the time, "smoothed" for those of the targets.
        min_speed: of the causal estimate at the start [m/s]; None for the dataset's.
        horizon: number of predicted steps.
        feature_set: default set of features and normals (`conventions.FEATURE_SETS`).
        device: of batches.
        ground: tables shared with other windows on this device; read from disk by default.
    """

    def __init__(
        self,
        dataset: Dataset,
        part: str,
        *,
        start: str = "causal",
        min_speed: float | None = None,
        horizon: int = HORIZON_STEPS,
        feature_set: str = "hindsight",
        device: torch.device | str = "cpu",
        ground: GroundTables | None = None,
    ) -> None:
        self.dataset, self.part, self.horizon, self.start = dataset, part, horizon, start
        self.device = torch.device(device)
        self.read_ahead = self.device.type == "cuda"
        min_speed = dataset.min_speed if min_speed is None else min_speed
        rows = [drive.rows for drive in dataset.drives]
        names = [name for name, column in COLUMNS.items() if column.segments and not column.by_feature_set]
        self._columns = {name: self._joined([r.column(name) for r in rows]) for name in names}
        if start != "causal":
            for name in ("state", "actuators", "control"):
                self._columns[f"{name}_causal"] = self._columns[name]
        self._valid = self._joined([r.valid for r in rows])
        ground = ground or ground_tables(dataset, self.device)
        self._cells, self._with_features, self._normals = ground.cells, True, ground.normals
        self._level = False  # vertical normals instead of the recorded ones
        self.sets = self._cells.sets if self._cells is not None else 1
        self._set = set_number(feature_set, self.sets)
        self.control, self.actuators = dataset.rig.present_controls, dataset.rig.present_actuators

        self._offset = np.concatenate(([0], np.cumsum([len(r.time) for r in rows])))
        starts = [
            evaluation_starts(drive.rows, drive.part == part_number(part), dataset.min_hindsight, min_speed, horizon)
            for drive in dataset.drives
        ]
        self.drive: Int[np.ndarray, " n"] = np.repeat(np.arange(len(starts)), [len(each) for each in starts])
        self.rows: Int[np.ndarray, " n"] = np.concatenate(starts) + self._offset[self.drive]
        if not len(self.rows):
            raise no_window(dataset, part, horizon, min_speed)
        self.wheels: Float[Tensor, "4 2"] = torch.as_tensor(
            dataset.rig.wheel_positions(), dtype=torch.float32, device=self.device
        )
        self.maps = WindowMaps(dataset.drives, self.drive, np.concatenate(starts), self.device)
        self.drive_names = tuple(d.name for d in dataset.drives)

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        maps = int(self.maps.snapped.sum())
        return (
            f"<{len(self)} windows of part '{self.part}' of {self.dataset.path}\n"
            f"  {self.horizon} steps of {DT} s after {HISTORY_STEPS} rows of the past, {self.start} starts\n"
            f"  in {len(np.unique(self.drive))} drives; {maps} begin with the map as it was>"
        )

    def __getitem__(self, chosen: int | slice | Sequence[int] | np.ndarray) -> "Windows":
        """Select windows by number, slice, list or mask without copying data."""
        other, index = copy(self), np.atleast_1d(np.arange(len(self))[chosen])
        other.rows, other.drive, other.maps = self.rows[index], self.drive[index], self.maps.take(index)
        return other

    def every(self, stride: int, *, phase: int = 0) -> Int[np.ndarray, " n"]:
        """Return the indices of windows whose row in their drive is `phase` modulo `stride`."""
        return np.flatnonzero((self.rows - self._offset[self.drive]) % stride == phase % stride)

    def strided(self, stride: int, *, phase: int = 0) -> Int[np.ndarray, " n"]:
        """Return the indices of `every`, or all indices if there are none."""
        index = self.every(stride, phase=phase)
        return index if len(index) else np.arange(len(self))

    def with_feature_set(self, feature_set: str) -> "Windows":
        """Return the windows with another default feature set."""
        other = copy(self)
        other._set = set_number(feature_set, self.sets)
        return other

    def without_features(self) -> "Windows":
        """Return the windows without features in their batches."""
        other = copy(self)
        other._with_features = False
        return other

    def without_terrain(self, horizon: int | None = None, device: torch.device | None = None) -> "Windows":
        """Return the windows on level ground with the columns of `MOTION` only, of at most `horizon` steps."""
        other = copy(self)
        other.device = device or self.device
        other.read_ahead = other.device.type == "cuda"
        other._cells, other._level = None, True
        other._columns = {name: self._columns[name].to(other.device) for name in MOTION}
        other.horizon = min(horizon or self.horizon, self.horizon)
        return other

    def evaluation_indices(self, stride: int) -> Int[np.ndarray, " n"]:
        """Return the indices of windows for evaluation: those with a snapshot of the map, if there are any."""
        return np.flatnonzero(self.maps.snapped) if self.maps.snapped.any() else self.strided(stride)

    def row_in_drive(self, index: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Return the row t of windows, counted from the start of their drive."""
        return np.asarray(self.rows[index] - self._offset[self.drive[index]])

    def gather(self, index: Int[np.ndarray, " B"], feature_set_choice: FeatureSetChoice | None = None) -> Batch:
        """Gather a batch of windows, with their default feature set or a choice of sets."""
        feature_set_choice = feature_set_choice or same_feature_set(len(index), self._set)
        read = self._segments(index)
        first, count = self.rows[index] - HISTORY_STEPS, HISTORY_STEPS + self.horizon
        terrain = self._terrain(first, count, feature_set_choice)
        before, after = terrain.rows(slice(HISTORY_STEPS)), terrain.rows(slice(HISTORY_STEPS, None))
        if self._cells is None and "normal_causal" in read and self.start == "causal":
            before = Terrain.of(read["normal_causal"]["past"][:, :, None].expand_as(before.normal))
        cells = self._cells if self._with_features else None
        ground = None if cells is None else cells.under(first, count, feature_set_choice, HISTORY_STEPS)
        state, actuators, control = read["state_causal"], read["actuators_causal"], read["control_causal"]
        extra = {name: values for name, values in read.items() if name not in OWN_COLUMNS}
        past = {name: values["past"] for name, values in extra.items() if "past" in values}
        return Batch(
            history=History(state["past"], actuators["past"], control["past"], before, past),
            state=state["start"],
            actuators=actuators["start"],
            control=read["control"]["ahead"],
            terrain=after,
            target=read["state"]["target"],
            target_actuators=read["actuators"]["target"],
            ground=ground,
            extra=extra,
        )

    def _segments(self, index: Int[np.ndarray, " B"]) -> dict[str, dict[Segment, Tensor]]:
        """Return the declared segments of each column, `relative` ones from px, py and whole turns at the start."""
        t = torch.as_tensor(self.rows[index], device=self.device)
        ahead = t[:, None] + torch.arange(self.horizon, device=self.device)
        past = t[:, None] + torch.arange(-HISTORY_STEPS, 0, device=self.device)
        rows: dict[Segment, Tensor] = {"past": past, "start": t, "ahead": ahead, "target": ahead + 1}
        start = self._columns["state_causal"][t]
        place = torch.zeros_like(start)
        place[:, :2] = start[:, :2]
        place[:, 2] = start[:, 2] - wrap_angle(start[:, 2])
        result = {}
        for name, values in self._columns.items():
            parts = {segment: values[rows[segment]] for segment in COLUMNS[name].segments}
            if COLUMNS[name].relative:
                parts = {key: part - (place if key == "start" else place[:, None]) for key, part in parts.items()}
            result[name] = parts
        return result

    def _terrain(self, first: Int[np.ndarray, " B"], count: int, choice: FeatureSetChoice) -> Terrain:
        """Return the ground at rows from `first`, refusing normals that are neither unit vectors nor unknown cells.

        Normals stay on disk when a dataset is opened, so they are checked when a batch reads them.
        """
        up = torch.tensor([0.0, 0.0, 1.0], device=self.device)
        if self._level:
            normal = up.expand(len(first), count, 4, 3)
            return Terrain(normal, normal.new_ones((), dtype=torch.bool).expand(normal.shape[:-1]), normal[..., :0])
        normal = self._normals.at(first, count, choice.normals)
        unit = (torch.linalg.vecdot(normal, normal) - 1).abs() < UNIT_TOLERANCE
        others = normal[~unit]
        if not (others.isnan().all() if self.dataset.features else not len(others)):
            what = "surface normals of the dataset are not unit vectors"
            raise DatasetError(what, where=self.dataset.path, how="extract it again")
        return Terrain(torch.where(unit[..., None], normal, up), unit, normal[..., :0])

    def features_at_starts(self, most: int = 20_000) -> tuple[Float[Tensor, "M F"], Bool[Tensor, " M"]]:
        """Return features under the wheels at up to `most` window starts, and their validity."""
        if self._cells is None:
            raise DatasetError("no terrain features", how="extract them with `--features ground-truth`")
        chosen = self.rows[np.unique(np.linspace(0, len(self) - 1, min(most, len(self))).astype(int))]
        under = self._cells.under(chosen, 1, same_feature_set(len(chosen), self._set))
        cells = under.ahead.flatten()
        return under.features[cells], under.valid[cells]

    def path(self, index: Int[np.ndarray, " B"]) -> tuple[Float[Tensor, "B P 2"], Float[Tensor, "B P 3"]]:
        """Return the recorded path from a second before the start of windows to eight seconds after it.

        Returns:
            px, py relative to each window's start [m], infinite at invalid rows; surface normals, NaN where unknown.
        """
        rows = self.rows[index][:, None] + np.arange(round(-1 / DT), round(8 / DT) + 1)
        first, end = self._offset[self.drive[index]], self._offset[self.drive[index] + 1]
        inside = (rows >= first[:, None]) & (rows < end[:, None])
        near = torch.as_tensor(np.clip(rows, first[:, None], end[:, None] - 1), device=self.device)
        known = torch.as_tensor(inside, device=self.device) & self._valid[near]
        start = self._columns["state_causal"][torch.as_tensor(self.rows[index], device=self.device), None, :2]
        position = torch.where(known[..., None], self._columns["state"][near][..., :2] - start, torch.inf)
        return position, self._driven_normal[near][..., 0, :]

    def places(self, index: Int[np.ndarray, " B"]) -> Float[Tensor, "B 2"]:
        """Return px, py of window starts in the world frame, in double precision [m]."""
        start = self._columns["state_causal"][torch.as_tensor(self.rows[index], device=self.device), :2].double()
        origin = np.stack([drive.rows.origin for drive in self.dataset.drives])[self.drive[index]]
        return start + torch.as_tensor(origin, device=self.device)

    @cached_property
    def _driven_normal(self) -> Float[Tensor, "N 4 3"]:
        return self._normals.whole()

    def _joined(self, arrays: list[np.ndarray]) -> Tensor:
        return torch.as_tensor(np.concatenate(arrays), device=self.device)
