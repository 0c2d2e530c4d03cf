from dataclasses import replace

import numpy as np
import pytest

from offpiste.simulation.rendering.meshes import SURFACES
from offpiste.simulation.rendering.scene import world_scene
from offpiste.simulation.sample import Motion, Pose, motionless
from offpiste.simulation.sensors.lidar import REFLECTIVITY, Lidar, LidarSettings, _reflect, _turn, lost_share
from offpiste.simulation.sensors.suite import mounted, sensor_suite
from simulation import scenes

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
SETTINGS = LidarSettings("lidar", mounted((0.0, 0.0, 1.95)), rings=32, columns=512)


def _plane(slope=(0.0, 0.0)):
    return world_scene(scenes.world(size=300, resolution=5.0, slope=slope))


def _scan(settings=SETTINGS, scene=None, motion=None, seed=0):
    scene = scene or _plane()
    motion = motion or motionless(Pose(np.array([0.0, 0.0, 0.36]), UPRIGHT))
    return Lidar(settings).scan(scene, motion, 0.0, np.random.default_rng(seed))


def test_points_of_a_plane_lie_on_it_to_the_noise():
    slope = (0.1, -0.05)
    up = np.array([-slope[0], -slope[1], 1.0])
    pose = Pose(np.array([1.0, 2.0, 0.5]), UPRIGHT)
    scan = _scan(scene=_plane(slope), motion=motionless(pose))
    of_ground = scan.surface == SURFACES.index("ground")
    points = (pose @ SETTINGS.body_from_lidar).apply(scan.points[of_ground].astype(float))
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
    in_body = settings.body_from_lidar.apply(scan.points[of_ground].astype(float))

    def off(time):
        position, rotation = motion.at(time)
        world = np.einsum("nij,nj->ni", rotation, in_body) + position
        return np.abs(world @ up) / np.linalg.norm(up)

    time = scan.time[of_ground].astype(float)
    assert off(5.0 + time).max() < 2e-3
    assert off(np.full_like(time, 5.0)).max() > 0.05


def test_rays_are_lost_at_the_rate_that_the_formula_says():
    far = np.full(100_000, 40.0)
    echo = np.full(100_000, 0.2)
    share = lost_share(SETTINGS, far, echo)
    # strength 0.2 / 0.1 (80 / 40)^2 = 8: 0.01 + 0.99 * 0.5^8
    np.testing.assert_allclose(share, 0.01 + 0.99 / 256)
    assert lost_share(SETTINGS, np.array([80.0]), np.array([0.1])) == pytest.approx(0.01 + 0.99 * 0.5)
    distance, cosine = np.meshgrid(np.linspace(1, 80, 50), np.linspace(0.01, 1, 50))
    share = lost_share(SETTINGS, distance.ravel(), 0.3 * cosine.ravel()).reshape(distance.shape)
    assert (np.diff(share, axis=1) >= 0).all()
    assert (np.diff(share, axis=0) <= 0).all()

    # Level ground: compare with what a scan keeps within 10 to 30 m.
    settings = replace(SETTINGS, range_noise=0.0, columns=2048)
    elevation = np.linspace(settings.highest, settings.lowest, settings.rings)
    ring = np.flatnonzero(elevation < -0.05)
    height = 0.36 + 1.95
    distance = height / -np.sin(elevation[ring])
    expected = 1 - lost_share(settings, distance, 0.3 * -np.sin(elevation[ring]))
    scan = _scan(settings)
    of_ground = scan.surface == SURFACES.index("ground")
    kept = np.bincount(scan.ring[of_ground], minlength=settings.rings)[ring] / settings.columns
    clear = distance > 6  # nearer rings also meet the roof
    np.testing.assert_allclose(kept[clear], expected[clear], atol=0.05)


def test_the_vehicle_sees_itself_and_the_low_unit_looks_behind():
    full = sensor_suite("full")
    body = SURFACES.index("body")
    low = replace(full.lidars[1], rings=32, columns=512)
    scan = _scan(low)
    own = low.body_from_lidar.apply(scan.points[scan.surface == body].astype(float))
    assert len(own) > 200
    assert (np.abs(own) < [1.6, 0.9, 1.7]).all()
    ground = low.body_from_lidar.apply(scan.points[scan.surface == SURFACES.index("ground")].astype(float))
    assert (ground[:, 0] < -1.4).mean() > 0.7
    assert np.linalg.norm(ground[:, :2], axis=1).min() < 3.0


def test_the_same_seed_repeats_a_scan():
    scene = _plane()
    one, again, other = (_scan(scene=scene, seed=seed) for seed in (1, 1, 2))
    for name in vars(one):
        np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
    assert len(one.points) != len(other.points) or (one.points != other.points).any()


def test_plants_return_points():
    scene = world_scene(scenes.world(trees=scenes.tree(8.0, 0.0), bushes=scenes.bush(0.0, 6.0)))
    scan = _scan(scene=scene)
    points = (Pose(np.array([0.0, 0.0, 0.36]), UPRIGHT) @ SETTINGS.body_from_lidar).apply(scan.points.astype(float))
    for surface, place in (("crown", (8.0, 0.0)), ("bush", (0.0, 6.0))):
        found = points[scan.surface == SURFACES.index(surface)]
        assert len(found) > 10
        assert np.linalg.norm(found[:, :2] - place, axis=1).max() < 3.0


def test_rays_turn_with_their_column_and_reflect_by_the_cosine():
    rng = np.random.default_rng(0)
    rotation, body = rng.normal(size=(5, 3, 3)), rng.normal(size=(4, 5, 3))
    rays = np.empty((20, 3), np.float32)
    _turn(rotation, body, rays)
    np.testing.assert_allclose(rays, np.einsum("cij,rcj->rci", rotation, body).reshape(-1, 3), rtol=1e-4, atol=1e-6)

    # Two of four rings, from the second on.
    rays, normal = rays[5:15], rng.normal(size=(10, 3)).astype(np.float32)
    kind, far = rng.integers(0, len(REFLECTIVITY), 10).astype(np.int8), rng.random(10, np.float32)
    distance, echo, surface = (np.full((5, 4), -1, dtype) for dtype in (np.float32, np.float32, np.int8))
    _reflect(REFLECTIVITY, far, kind, normal, rays, 1, distance, echo, surface)
    np.testing.assert_array_equal(distance[:, 1:3], far.reshape(2, 5).T)
    np.testing.assert_array_equal(surface[:, 1:3], kind.reshape(2, 5).T)
    cosine = np.abs((normal * rays).sum(axis=1))
    np.testing.assert_allclose(echo[:, 1:3], (REFLECTIVITY[kind] * cosine).reshape(2, 5).T, rtol=1e-4, atol=1e-6)
    for each in (distance, echo, surface):
        assert (each[:, [0, 3]] == -1).all()
