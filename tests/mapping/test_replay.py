"""Which images are looked at, and which scans they are projected onto."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from factories import circle_rows
from offpiste.dataset.known_cells import CellList
from offpiste.dataset.map_snapshots import SnapshotSchedule, SnapshotSettings, SnapshotWriter
from offpiste.dataset.visual_features import SnapshotKeeper
from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Cloud, Image, Lidar
from offpiste.logs.poses import Poses, find_jumps
from offpiste.logs.sensor_log import SensorLog
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.replay import MapperSettings, SensorMapper, replay
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.rig.sensors import LidarSource
from offpiste.runtime.estimator import VehicleTrack
from runtime.stream import FEATURES, camera, extract_features, reading, scan
from sensor_bags import IMAGE, cloud, compressed, info, opened, record, tree

SETTINGS = MapperSettings(0.5, map=MapSettings(VoxelSettings(reach=24.0, capacity=200_000, threads=1)))
MEMORY = SETTINGS.memory


def image(time: float) -> Image:
    return Image(time, "eye", np.full((98, 140, 3), 120, np.uint8))


def pose(x: float) -> np.ndarray:
    world_from_body = np.eye(4)
    world_from_body[0, 3] = x
    return world_from_body


@pytest.fixture
def mapper() -> SensorMapper:
    mounting = np.eye(4)
    mounting[2, 3] = 2.0
    lidars = {"lidar": Lidar("lidar", mounting, LidarSource("/points"))}
    return SensorMapper({"eye": camera()}, lidars, extract_features, FEATURES, SETTINGS)


def test_an_image_is_due_after_some_way_or_some_time(mapper):
    assert mapper.is_keyframe(image(0.0), pose(0.0))
    mapper.add_image(image(0.0), pose(0.0))
    assert not mapper.is_keyframe(image(0.1), pose(0.49))
    assert mapper.is_keyframe(image(0.1), pose(0.51))
    assert not mapper.is_keyframe(image(MEMORY), pose(0.0))
    assert mapper.is_keyframe(image(MEMORY + 0.01), pose(0.0))


def test_a_turn_on_the_spot_counts_as_far_as_the_camera_goes(mapper):
    mapper.add_image(image(0.0), pose(0.0))
    turned = np.diag((-1.0, -1.0, 1.0, 1.0))  # the camera is 0.5 m ahead of the pose point: it goes 1 m
    assert mapper.is_keyframe(image(0.1), turned)


def test_old_images_are_not_projected(mapper):
    track = VehicleTrack()
    for row in range(150):
        track.add(reading(0.02 * row, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    mapper.add_image(image(0.5), pose(0.0))
    fresh = mapper.add_scan(scan(0.5 + MEMORY), track.poses(), pose(0.0))
    assert [keyframe.view.time for keyframe in fresh.keyframes] == [0.5]
    assert fresh.projection is not None
    assert mapper.pipeline.layers().valid.any()
    old = mapper.add_scan(scan(0.5 + MEMORY + 0.1), track.poses(), pose(0.0))
    assert (old.keyframes, old.projection) == ((), None)
    assert len(old.points_world) == len(fresh.points_world)


def test_points_at_unknown_poses_do_not_make_the_map_late(tmp_path):
    still = [(0, "/tf_static", tree()), (0, "/info", info())]
    scans = [(at, "/points", cloud(at)) for at in (0.5, 0.985)]  # the last point of the second comes after the poses
    sensors = opened(record(tmp_path / "x.mcap", [*still, (0.1, "/image", compressed(0.1, IMAGE)), *scans]))
    moments = [(moment.measured, len(moment.points_world)) for moment in replay(sensors, {}, extract_features, 0)]
    np.testing.assert_allclose(moments, [(100.52, 3), (100.995, 2)])


class ScriptedLog(SensorLog):
    """Scans and poses that are given."""

    def __init__(self, scans: list[Cloud], lidars: dict[str, Lidar], poses: Poses) -> None:
        self.lidars, self.cameras, self.poses, self._scans = lidars, {}, poses, scans

    def stream(self, *_: object, **__: object) -> Iterator[Image | Cloud]:
        return iter(self._scans)


class KeptInMemory(SnapshotWriter):
    """Snapshots by their rows."""

    def __init__(self) -> None:
        self.kept: dict[int, CellList] = {}

    def add(self, row: int, cells: CellList) -> None:
        self.kept[row] = cells

    def close(self) -> None:
        """Nothing is left to write."""


def jumping_log(scans: list[Cloud], lidars: dict[str, Lidar], *, jump: float = np.inf) -> ScriptedLog:
    """A log of a vehicle at 5 m/s on level ground, whose pose jumps 3 m up and 5 m aside at a time [s]."""
    time = np.arange(0, 8.001, 0.02)
    after = time >= jump
    position = Channel("position", "m", time, np.column_stack((5 * time, 5.0 * after, 3.0 * after)))
    orientation = Channel("orientation", "", time, np.tile([0, 0, 0, 1.0], (len(time), 1)))
    poses = Poses(position, orientation, 0.2, find_jumps(position, orientation))
    assert len(poses.jumps) == np.isfinite(jump)
    return ScriptedLog(scans, lidars, poses)


def ring(reach: float = 20.0, half: float = np.pi) -> np.ndarray:
    """Points on level ground 2 m below a LiDAR."""
    angle, radius = (grid.ravel() for grid in np.meshgrid(np.linspace(-half, half, 400), np.linspace(3, reach, 60)))
    return np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.full(angle.size, -2.0)))


def mast(name: str) -> Lidar:
    mounting = np.eye(4)
    mounting[2, 3] = 2.0
    return Lidar(name, mounting, LidarSource(f"/{name}"))


def test_a_scan_over_a_jump_leaves_what_is_on_its_other_side_out() -> None:
    """Its stamp is that of its end: the map that begins anew there would hold ground of the frame before."""
    points = ring()
    since = np.linspace(-0.1, 0.0, len(points))
    scans = [Cloud(t, "lidar", points, since, np.full(len(points), np.nan)) for t in np.arange(0.15, 3.0, 0.1).tolist()]
    off = {}
    for moment in replay(jumping_log(scans, {"lidar": mast("lidar")}, jump=2.0), {}, extract_features, 0, SETTINGS):
        ground = moment.layers.elevation
        off[round(moment.time, 2)] = np.mean(np.abs(ground[np.isfinite(ground)] - moment.vehicle[2]) > 1)
    assert {2.05, 2.15} <= set(off)
    assert set(off.values()) == {0.0}


def test_a_map_without_room_says_so_once(caplog: pytest.LogCaptureFixture) -> None:
    full = replace(SETTINGS, map=MapSettings(VoxelSettings(reach=24.0, capacity=100, threads=1)))
    scans = [Cloud(t, "lidar", ring(), None, np.full(24_000, np.nan)) for t in (0.5, 0.6, 0.7)]
    log = jumping_log(scans, {"lidar": mast("lidar")})
    assert len(list(replay(log, {}, extract_features, 0, full))) == 3
    assert [record.message[:26] for record in caplog.records] == ["the map has no room for mo"]
    caplog.clear()
    assert len(list(replay(log, {}, extract_features, 0, SETTINGS))) == 3
    assert not caplog.records


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
