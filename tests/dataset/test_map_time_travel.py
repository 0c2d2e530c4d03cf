"""Time travel of maps: no snapshot changes when images, scans and poses after its window's start are changed."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from offpiste.core.conventions import PERCEPTION_LATENCY
from offpiste.dataset.map_snapshots import SnapshotSchedule, SnapshotSettings, SnapshotWriter, open_snapshots
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.visual_features import SnapshotKeeper
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import open_log
from offpiste.logs.ros.sensor_messages import message_from_points
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.replay import MapperSettings, Moment, pinhole_cameras, replay
from offpiste.mapping.voxel_map import VoxelSettings
from sensor_bags import POINT, compressed, sensor_rig, stamp
from sensor_drive import AROUND, PICTURES, SECONDS, STATIC, poses, written

SWEEP = 0.21
"""Duration of a scan, from its stamp on [s]."""
PATCH = 14
SETTINGS = MapperSettings(map=MapSettings(VoxelSettings(reach=24.0, capacity=100_000, threads=1)))


def mean_colours(pixels: np.ndarray) -> np.ndarray:
    rows, columns = (side // PATCH for side in pixels.shape[:2])
    cut = pixels[: rows * PATCH, : columns * PATCH].reshape(rows, PATCH, columns, PATCH, 3)
    return (cut.mean(axis=(1, 3)) / 255).astype(np.float32)


def recorded(path: Path, change: float) -> Path:
    """Write a drive over level ground, on which ground, colours and path differ after a time [s]."""

    def late(time: np.ndarray | float) -> np.ndarray:
        return np.asarray(time) > change

    images, clouds = [], []
    for number, t in enumerate(np.arange(0.05, SECONDS, 0.25).tolist()):
        images.append((t, "/image", compressed(t, 255 - PICTURES[number] if late(t) else PICTURES[number])))
    offset = np.linspace(0, SWEEP, len(AROUND))
    for t in np.arange(0.1, SECONDS - SWEEP, 0.25).tolist():
        points = np.zeros(len(AROUND), POINT)
        points["x"], points["y"], points["z"] = AROUND.T
        points["z"] += np.where(late(t + offset), 0.4, 0.0)
        points["t"] = np.round(offset * 1e9)
        clouds.append((t, "/points", message_from_points(points, stamp(t), "lidar")))
    return written(path, STATIC, images, clouds, poses(lambda t: min(20 * max(t - change, 0.0), 0.5)))


def snapshots(
    log_path: Path, keeper: Callable[..., SnapshotKeeper], latency: float = PERCEPTION_LATENCY
) -> tuple[Rows, dict[int, tuple[np.ndarray, ...]]]:
    """Rows, and cells, elevations, rises and features of the maps at all rows that could be the start of a window."""
    rig = sensor_rig()
    log = open_log(log_path)
    rows = extract_rows(drive_from_log(log, rig))
    folder, settings = log_path.with_suffix(".snapshots"), SnapshotSettings(seconds=0.0, most=10**6, latency=latency)
    writer = SnapshotWriter(folder, SETTINGS.map.voxels.size, 3)
    sensors = open_sensors(log, rig)
    schedule = SnapshotSchedule([np.isfinite(rows.state_causal).all(axis=1)], settings)
    kept = keeper(writer, schedule, settings, rows, sensors.poses)
    for moment in replay(sensors, pinhole_cameras(sensors, PATCH), mean_colours, 3, SETTINGS, end=104.2):
        kept.update(moment)
    kept.close()
    opened = open_snapshots(folder)
    maps = [opened.load(number) for number in range(len(opened.row))]
    arrays = [(m.origin, m.elevation, m.rise, m.features) for m in maps]
    return rows, dict(zip(opened.row.tolist(), arrays, strict=True))


def differing(
    folder: Path, keeper: Callable[..., SnapshotKeeper], latency: float, change: float
) -> tuple[set[int], set[int]]:
    """Rows until a change whose snapshot differs in any bit, and later ones."""
    (rows, ours), (_, others) = (
        snapshots(recorded(folder / f"{at:g}.mcap", at), keeper, latency) for at in (np.inf, change)
    )
    until = 100.0 + change
    before = {row for row in ours if rows.time[row] <= until}
    assert len(before) > 5
    assert before == {row for row in others if rows.time[row] <= until}
    assert all(np.isfinite(ours[row][3]).any() for row in before)

    def same(row: int) -> bool:
        return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(ours[row], others[row], strict=True))

    unlike = {row for row in set(ours) & set(others) if not same(row)}
    return unlike & before, unlike - before


class AtStamp(SnapshotKeeper):
    """Keeps maps at the stamps of scans, whose points are measured later."""

    def update(self, moment: Moment) -> None:
        super().update(replace(moment, measured=moment.time - self.settings.latency, placed=moment.time))


class WithoutPoses(SnapshotKeeper):
    """Does not wait for the pose after the last point, towards which poses are interpolated."""

    def update(self, moment: Moment) -> None:
        super().update(replace(moment, placed=moment.time))


IN_A_SWEEP, BEFORE_A_POSE = (PERCEPTION_LATENCY, 3.21), (0.0, 3.085)
"""Latency and time of the change [s]: 0.11 s into a scan; 0.025 s after its last point and 0.015 s before a pose."""


@pytest.mark.parametrize("case", [IN_A_SWEEP, BEFORE_A_POSE])
def test_snapshots_do_not_depend_on_what_is_measured_after_their_windows_start(case, tmp_path: Path) -> None:
    early, later = differing(tmp_path, SnapshotKeeper, *case)
    assert not early
    assert later


@pytest.mark.parametrize(("keeper", "case"), [(AtStamp, IN_A_SWEEP), (WithoutPoses, BEFORE_A_POSE)])
def test_a_map_that_is_kept_too_early_is_found(keeper, case, tmp_path: Path) -> None:
    early, _ = differing(tmp_path, keeper, *case)
    assert early


def test_windows_start_a_latency_after_the_last_point_of_a_scan(tmp_path: Path) -> None:
    rows, kept = snapshots(recorded(tmp_path / "a.mcap", np.inf), SnapshotKeeper)
    ends = 100.1 + SWEEP + 0.25 * np.arange(len(kept))
    age = rows.time[np.array(sorted(kept))] - ends
    assert (age >= PERCEPTION_LATENCY - 1e-6).all()
    assert (age < PERCEPTION_LATENCY + 0.02 + 1e-6).all()
