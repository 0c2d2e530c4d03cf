"""Points in the world against NumPy: scans of any length, moments in any order, poses that are unknown."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Cloud, Lidar
from offpiste.logs.poses import Poses
from offpiste.perception import motion_compensation
from offpiste.perception.motion_compensation import MOMENT, points_in_world, put_in_world
from offpiste.rig.sensors import LidarSource
from textured_world import mounting


def plain(cloud: Cloud, lidar: Lidar, poses: Poses) -> np.ndarray:
    ticks, which = np.unique(np.round(cloud.times / MOMENT), return_inverse=True)
    matrix = (poses.at(ticks * MOMENT) @ lidar.body_from_lidar)[which]
    terms = matrix[:, :3, :3] * cloud.points[:, None]
    return terms.sum(axis=2) + matrix[:, :3, 3]


def curved(rng: np.random.Generator) -> Poses:
    time = np.linspace(0, 2, 101)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(size=(101, 3)) * 0.05, axis=0)).as_quat()
    return Poses(
        Channel("position", "m", time, np.cumsum(rng.normal(size=(101, 3)), axis=0) + 1000),
        Channel("orientation", "1", time, turns),
        0.5,
    )


@pytest.mark.parametrize("count", [0, 1, 5000])
@pytest.mark.parametrize("span", [0.0, 0.1, 30.0])
def test_points_in_world_are_those_of_numpy(count: int, span: float, monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(count)
    lidar = Lidar("top", mounting(Rotation.random(random_state=1), (0.3, -0.2, 1.9)), LidarSource(topic="top"))
    offset = None if span == 0 else rng.uniform(-0.3 * span, span, count)
    cloud = Cloud(0.01, "top", rng.normal(size=(count, 3)) * 40, offset, np.ones(count))
    poses = curved(rng)
    world = points_in_world(cloud, lidar, poses)
    np.testing.assert_allclose(world, plain(cloud, lidar, poses), rtol=0, atol=1e-11)
    if count > 1 and span > 0:
        assert np.isnan(world).any()  # before the log begins
        assert np.isfinite(world).any()
    monkeypatch.setattr(motion_compensation, "put_in_world", put_in_world.plain)
    np.testing.assert_allclose(points_in_world(cloud, lidar, poses), world, rtol=0, atol=1e-11)


def test_a_scan_with_a_time_too_few_is_refused():
    cloud = Cloud(0.0, "top", np.zeros((5, 3)), np.zeros(5), np.ones(5))
    object.__setattr__(cloud, "offset", np.zeros(4))
    with pytest.raises(ValueError, match="reshape"):
        points_in_world(cloud, Lidar("top", np.eye(4), LidarSource(topic="top")), curved(np.random.default_rng(0)))
