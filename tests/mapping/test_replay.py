"""Which images are looked at, and which scans they are projected onto."""

import numpy as np
import pytest

from offpiste.logs.measurements import Image, Lidar
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
