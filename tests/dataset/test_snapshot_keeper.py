"""Which maps are kept as snapshots: those of the window's frame, with the scans of all LiDARs."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from factories import circle_rows
from offpiste.dataset.map_snapshots import CellList, SnapshotSchedule, SnapshotSettings, SnapshotWriter
from offpiste.dataset.visual_features import SnapshotKeeper
from offpiste.logs.measurements import Cloud
from offpiste.mapping.replay import replay
from runtime.stream import extract_features
from scripted_log import SETTINGS, ScriptedLog, jumping_log, mast, ring


class KeptInMemory(SnapshotWriter):
    """Snapshots by their rows."""

    def __init__(self) -> None:
        self.kept: dict[int, CellList] = {}

    def add(self, row: int, cells: CellList) -> None:
        self.kept[row] = cells

    def close(self) -> None:
        """Nothing is left to write."""


def kept_snapshots(log: ScriptedLog, latency: float, starts: Callable[[np.ndarray], np.ndarray]) -> dict[int, CellList]:
    """Snapshots of every row of a log's poses that may be the start of a window."""
    time, place = log.poses.position.time, log.poses.position.values
    states = np.column_stack((place[:, :2], 0 * time, 5 + 0 * time, 0 * time, 0 * time)).astype(np.float32)
    rows = replace(circle_rows(len(time)), time=time, origin=np.zeros(2), state_causal=states)
    settings, writer = SnapshotSettings(seconds=0.0, most=10**6, latency=latency), KeptInMemory()
    keeper = SnapshotKeeper(writer, SnapshotSchedule([starts(time)], settings), settings, rows, log.poses)
    for moment in replay(log, {}, extract_features, 0, SETTINGS):
        keeper.update(moment)
    keeper.close()
    return writer.kept


def test_snapshots_do_not_depend_on_the_order_of_the_lidars() -> None:
    """Of scans with one stamp the last completes the map."""
    front = ring(12.0, np.pi / 2)
    of = {"front": front, "rear": front * [-1, 1, 1]}
    kept = []
    for names in (("rear", "front"), ("front", "rear")):
        stamps = [(t, name) for t in np.arange(0.5, 3, 0.1).tolist() for name in names]
        scans = [Cloud(t, name, of[name], None, np.full(len(front), np.nan)) for t, name in stamps]
        kept.append(kept_snapshots(jumping_log(scans, {n: mast(n) for n in names}), 0.1, np.isfinite))
    assert list(kept[0]) == list(kept[1])
    assert len(kept[0]) == 25
    for row, cells in kept[0].items():
        np.testing.assert_array_equal(cells.place, kept[1][row].place)


@pytest.mark.parametrize("latency", [0.1, 0.8])
def test_a_snapshot_is_of_the_frame_of_its_window(latency: float) -> None:
    scans = [Cloud(t, "lidar", ring(), None, np.full(24_000, np.nan)) for t in np.arange(0.5, 5, 0.1).tolist()]
    log = jumping_log(scans, {"lidar": mast("lidar")}, jump=2.0)
    kept = kept_snapshots(log, latency, lambda time: (time < 2) | (time >= 2.5))
    for row, cells in kept.items():
        assert np.median(cells.elevation) == pytest.approx(log.poses.position.values[row, 2], abs=0.1)
    times = log.poses.position.time[list(kept)]
    assert min(times[times > 2]) == pytest.approx(max(2.5, 2.0 + latency), abs=0.13)
