from dataclasses import replace

import numpy as np
import pytest

from offpiste.simulation.rendering.scene import SURFACES, world_scene
from offpiste.simulation.sample import Motion, Pose
from offpiste.simulation.sensors.lidar import Lidar, LidarSettings
from offpiste.simulation.sensors.suite import mounted
from simulation import scenes

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
SETTINGS = LidarSettings("lidar", mounted((0.0, 0.0, 1.95)), rings=32, columns=512)


def _plane(slope=(0.0, 0.0)):
    return world_scene(scenes.world(size=300, resolution=5.0, slope=slope))


def _scan(settings=SETTINGS, scene=None, motion=None, seed=0):
    scene = scene or _plane()
    motion = motion or scenes.motionless(Pose(np.array([0.0, 0.0, 0.36]), UPRIGHT))
    return Lidar(settings).scan(scene, motion, 0.0, np.random.default_rng(seed))


def test_points_of_a_plane_lie_on_it_to_the_noise():
    slope = (0.1, -0.05)
    up = np.array([-slope[0], -slope[1], 1.0])
    pose = Pose(np.array([1.0, 2.0, 0.5]), UPRIGHT)
    scan = _scan(scene=_plane(slope), motion=scenes.motionless(pose))
    of_ground = scan.surface == SURFACES.index("ground")
    points = pose.apply(SETTINGS.body_from_sensor.apply(scan.points[of_ground].astype(float)))
    # Noise acts along the ray: over the cosine of incidence to get from the plane's normal to the ray.
    ray = scan.points[of_ground] / np.linalg.norm(scan.points[of_ground], axis=1, keepdims=True)
    along = (points @ up) / (ray @ up)
    assert len(along) > 3000
    assert along.std() == pytest.approx(SETTINGS.range_noise, rel=0.1)
    assert abs(along.mean()) < 4 * SETTINGS.range_noise / np.sqrt(len(along))


def test_rings_and_times_say_how_a_point_was_measured():
    scan = _scan(replace(SETTINGS, range_noise=0.0))
    elevation = np.arcsin(scan.points[:, 2] / np.linalg.norm(scan.points, axis=1))
    step = (SETTINGS.lowest - SETTINGS.highest) / (SETTINGS.rings - 1)
    np.testing.assert_allclose(elevation, SETTINGS.highest + step * scan.ring, atol=1e-5)
    azimuth = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    turned = (np.pi - azimuth) % (2 * np.pi)
    off = (turned - 2 * np.pi * SETTINGS.rate * scan.time + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(off, 0.0, atol=1e-5)
    assert scan.time.min() >= 0
    assert scan.time.max() < 1 / SETTINGS.rate


def test_a_moving_sweep_is_straight_again_once_each_point_is_put_where_the_vehicle_was():
    scene = world_scene(scenes.world(size=300, resolution=5.0, slope=(0.05, 0.1)))
    up = np.array([-0.05, -0.1, 1.0])
    turn = np.array([0.0, 0.0, np.sin(0.1), np.cos(0.1)])  # 0.2 rad in 0.1 s
    motion = Motion(np.array([5.0, 5.1]), np.array([[0.0, 0, 1.0], [1.2, 0.1, 1.1]]), np.stack((UPRIGHT, turn)))
    settings = replace(SETTINGS, range_noise=0.0)
    scan = Lidar(settings).scan(scene, motion, 5.0, np.random.default_rng(0))
    of_ground = scan.surface == SURFACES.index("ground")
    in_body = settings.body_from_sensor.apply(scan.points[of_ground].astype(float))

    def off(time):
        position, rotation = motion.at(time)
        world = np.einsum("nij,nj->ni", rotation, in_body) + position
        return np.abs(world @ up) / np.linalg.norm(up)

    time = scan.time[of_ground].astype(float)
    assert off(5.0 + time).max() < 2e-3
    assert off(np.full_like(time, 5.0)).max() > 0.05


def test_rays_are_lost_by_range_and_grazing_angle():
    settings = replace(SETTINGS, range_noise=0.0, columns=2048)
    elevation = np.linspace(settings.highest, settings.lowest, settings.rings)
    ring = np.flatnonzero(elevation < -0.05)
    height = 0.36 + 1.95
    distance = height / -np.sin(elevation[ring])
    # `lost` holds at the largest range for an echo of 0.1; echoes fade with the square of the range.
    strength = 0.3 * -np.sin(elevation[ring]) / 0.1 * (settings.max_range / distance) ** 2
    expected = (1 - settings.dropout) * (1 - settings.lost**strength)
    scan = _scan(settings)
    of_ground = scan.surface == SURFACES.index("ground")
    kept = np.bincount(scan.ring[of_ground], minlength=settings.rings)[ring] / settings.columns
    clear = distance > 6  # nearer rings also meet the roof
    np.testing.assert_allclose(kept[clear], expected[clear], atol=0.05)
