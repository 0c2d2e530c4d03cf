"""Usable points of a cloud against plain NumPy: no echoes, ranges, the vehicle itself, and what is no number."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offpiste.logs.log import RawCloud
from offpiste.logs.measurements import Lidar, cloud_from_records, usable_points
from offpiste.rig.sensors import LidarSource

BOX = ((-1.0, -2.0, -1.0), (3.0, 0.5, 2.0))


def plain(points: np.ndarray, lidar: Lidar) -> np.ndarray:
    source = lidar.source
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(points, axis=1)
        keep = np.isfinite(distance) & (distance > 0) & (distance >= source.min_range) & (distance <= source.max_range)
        if source.own_body is not None:
            body = points @ lidar.body_from_lidar[:3, :3].T + lidar.body_from_lidar[:3, 3]
            keep &= ~((body >= source.own_body[0]) & (body <= source.own_body[1])).all(axis=1)
    return keep


def top(**options) -> Lidar:
    mounting = np.eye(4)
    mounting[:3, :3], mounting[:3, 3] = Rotation.random(random_state=3).as_matrix(), (0.1, 0.2, 1.9)
    return Lidar("top", mounting, LidarSource(topic="top", **options))


@pytest.mark.parametrize("count", [0, 3, 6000])
@pytest.mark.parametrize("options", [{}, {"own_body": BOX}, {"own_body": BOX, "min_range": 2.0, "max_range": 9.0}])
def test_usable_points_are_those_of_numpy(count: int, options: dict):
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3)) * 4
    for number, fault in enumerate((0.0, np.nan, np.inf, 1e300)):
        points[number::50] = fault
    points[4::50, 1] = np.nan
    lidar = top(**options)
    usable = usable_points(points, lidar)
    np.testing.assert_array_equal(usable, plain(points, lidar))
    if count > 100:
        assert 0 < usable.sum() < count


@pytest.mark.parametrize("kind", ["<f4", "<f8", "<i2"])
def test_records_of_any_number_become_points(kind: str):
    rng = np.random.default_rng(0)
    records = np.zeros(300, [("pad", "u1"), ("x", kind), ("y", kind), ("z", kind), ("intensity", "<f4")])
    for name in "xyz":
        records[name] = rng.integers(-30, 30, 300)
    records["intensity"] = np.arange(300)
    cloud = cloud_from_records(RawCloud(1.0, "top", records), top(own_body=BOX))
    points = np.stack([records[name] for name in "xyz"], axis=1).astype(np.float64)
    keep = plain(points, top(own_body=BOX))
    np.testing.assert_array_equal(cloud.points, points[keep])
    np.testing.assert_array_equal(cloud.intensity, records["intensity"][keep])
    assert cloud.offset is None
