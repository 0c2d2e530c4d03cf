"""Choice of keyframes, and of the scans projected onto them."""

from dataclasses import replace

import numpy as np
import pytest

from offpiste.logs.measurements import Cloud, Image
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.replay import SensorMapper, replay
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.runtime.estimator import VehicleTrack
from runtime.stream import FEATURES, camera, extract_features, reading, scan
from scripted_log import SETTINGS, jumping_log, mast, ring
from sensor_bags import IMAGE, cloud, compressed, info, opened, record, tree

MEMORY = SETTINGS.memory


def image(time: float) -> Image:
    return Image(time, "eye", np.full((98, 140, 3), 120, np.uint8))


def pose(x: float) -> np.ndarray:
    world_from_body = np.eye(4)
    world_from_body[0, 3] = x
    return world_from_body


@pytest.fixture
def mapper() -> SensorMapper:
    return SensorMapper({"eye": camera()}, {"lidar": mast("lidar")}, extract_features, FEATURES, SETTINGS)


def test_an_image_is_due_after_some_way_or_some_time(mapper):
    assert mapper.keyframes.due(image(0.0), pose(0.0))
    mapper.add_image(image(0.0), pose(0.0))
    assert not mapper.keyframes.due(image(0.1), pose(0.49))
    assert mapper.keyframes.due(image(0.1), pose(0.51))
    assert not mapper.keyframes.due(image(MEMORY), pose(0.0))
    assert mapper.keyframes.due(image(MEMORY + 0.01), pose(0.0))


def test_a_turn_on_the_spot_counts_as_far_as_the_camera_goes(mapper):
    mapper.add_image(image(0.0), pose(0.0))
    turned = np.diag((-1.0, -1.0, 1.0, 1.0))  # the camera is 0.5 m ahead of the pose point: it goes 1 m
    assert mapper.keyframes.due(image(0.1), turned)


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
    assert [record.message[:15] for record in caplog.records] == ["the map is full"]
    caplog.clear()
    assert len(list(replay(log, {}, extract_features, 0, SETTINGS))) == 3
    assert not caplog.records
