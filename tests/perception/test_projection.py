"""Projection of points into images: hand-worked answers, a moving vehicle, a wall, and plain NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Camera, Cloud, Lidar
from offpiste.logs.poses import Poses
from offpiste.perception import projection
from offpiste.perception.camera import make_pinhole_camera
from offpiste.perception.motion_compensation import inverse, points_in_world, transformed
from offpiste.perception.projection import (
    FREE,
    NEAREST,
    SECTORS,
    CameraView,
    Projection,
    occluded_points,
    project,
)
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource, LidarSource
from textured_world import mounting

AHEAD = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""`body_from_camera` of a camera at the pose point that looks ahead."""
MATRIX = np.array([[100.0, 0.0, 79.5], [0.0, 100.0, 59.5], [0.0, 0.0, 1.0]])
SKEWED = np.array([[90.0, 0.3, 79.5], [0.0, 110.0, 59.5], [0.0, 0.0, 1.0]])


def view(*, mounted=AHEAD, matrix=MATRIX, own_body=(), patch=10) -> CameraView:
    """160x120 pixels without distortion, from a vehicle at the origin."""
    source = CameraSource(topic="front", own_body=own_body)
    camera = make_pinhole_camera(Camera("front", CameraModel(160, 120, matrix), mounted, source), patch)
    return CameraView(camera, 0.0, mounted)


def straight(speed: float, *, yaw_rate: float = 0.0) -> Poses:
    """Along x, turning about z, from -1 to 1 s."""
    time = np.linspace(-1, 1, 41)
    position = np.column_stack((speed * time, np.zeros((41, 2))))
    turns = Rotation.from_rotvec(np.outer(yaw_rate * time, [0, 0, 1])).as_quat()
    return Poses(Channel("position", "m", time, position), Channel("orientation", "1", time, turns), 0.5)


def test_by_hand():
    points = np.array([[10.0, 0.0, 0.0], [10.0, 1.0, 2.0], [5.0, -2.0, -1.0]])
    found = project(points, [view()])
    np.testing.assert_allclose(found.pixel, [[79.5, 59.5], [69.5, 39.5], [119.5, 79.5]])
    assert found.column.tolist() == [8, 7, 12]
    assert found.row.tolist() == [6, 4, 8]
    np.testing.assert_allclose(found.distance, np.linalg.norm(points, axis=1))
    assert found.seen.all()


def test_a_sweep_is_unbent_while_the_vehicle_drives_and_turns():
    """Points of a wall at rest, each as the LiDAR saw it at its own moment."""
    poses = straight(12.0, yaw_rate=0.8)
    mounted = mounting(Rotation.from_euler("zy", (0.3, 0.1)), (1.0, 0.2, 1.8))
    wall = np.column_stack((np.full(200, 30.0), np.linspace(-20, 20, 200), np.linspace(0, 3, 200)))
    offset = np.linspace(0, 0.1, 200)
    seen = np.stack(
        [
            transformed(point[None], inverse(matrix @ mounted))[0]
            for point, matrix in zip(wall, poses.at(0.2 + offset), strict=True)
        ]
    )
    lidar = Lidar("top", mounted, LidarSource(topic="top"))
    carried = points_in_world(Cloud(0.2, "top", seen, offset, np.ones(200)), lidar, poses)
    assert np.abs(carried - wall).max() < 0.005  # the poses' moments are rounded to 0.1 ms
    bent = points_in_world(Cloud(0.2, "top", seen, None, np.ones(200)), lidar, poses)
    assert np.linalg.norm(bent - wall, axis=1).max() > 1.0


def grid(x: float, half: float, step: float) -> np.ndarray:
    """An upright square across the line of sight."""
    y, z = (axis.ravel() for axis in np.meshgrid(*2 * (np.arange(-half, half + step / 2, step),)))
    return np.column_stack((np.full(len(y), x), y, z))


def test_a_wall_hides_what_is_behind_it_though_its_points_are_sparse():
    wall, behind = grid(5.0, 1.0, 0.05), grid(15.0, 5.5, 0.31)
    found = project(np.concatenate((wall, behind)), [view()])
    assert found.seen[: len(wall)].all()
    tangent = behind[:, 1:] / 15
    inside, outside = (np.abs(tangent) < 0.19).all(axis=1), (np.abs(tangent) > 0.22).any(axis=1)
    assert not found.seen[len(wall) :][inside].any()
    assert found.seen[len(wall) :][outside].all()
    assert project(behind, [view()]).seen.all()


def test_of_two_cameras_the_one_that_looks_at_the_point_is_taken():
    turned = mounting(Rotation.from_euler("z", 40, degrees=True), (0, 0, 0))
    views = [view(), view(mounted=turned @ AHEAD)]
    angles = np.deg2rad([-10, 15, 25, 60])
    points = 10 * np.column_stack((np.cos(angles), np.sin(angles), np.zeros(4)))
    assert project(points, views).view.tolist() == [0, 0, 1, 1]  # the middle lies at 20 degrees
    # What the better camera cannot see, the other one shows.
    wall = points[2] * 0.3
    assert project(np.stack((points[2], wall)), views).view.tolist() == [-1, 1]


@pytest.mark.filterwarnings("error")
def test_points_that_are_not_finite_are_not_seen_and_warn_of_nothing():
    points = np.array([[10.0, 0, 0], [np.nan, 0, 0], [np.inf, np.inf, 0], [1e308, -1e308, 1e308], [10.0, np.nan, 0]])
    assert project(points, [view()]).view.tolist() == [0, -1, -1, -1, -1]


def plain(points_world: np.ndarray, views: list[CameraView]) -> Projection:
    """Project by 4 x 4 matrices, one point at a time."""
    n = len(points_world)
    found = Projection(np.full(n, -1), np.full((n, 2), np.nan), np.zeros(n, int), np.zeros(n, int), np.full(n, np.nan))
    best = np.full(n, np.inf)
    for number, this in enumerate(views):
        model, grid = this.camera.model, this.camera.grid
        points = transformed(points_world, np.linalg.inv(this.world_from_camera))
        pixels, away = (points @ model.matrix.T)[:, :2] / points[:, 2:], np.linalg.norm(points, axis=1)
        inside = ((pixels > -0.5) & (pixels < np.array(model.size) - 0.5)).all(axis=1)
        shown = np.flatnonzero(inside & (points[:, 2] > NEAREST))
        reach = float(model.matrix[0, 0]) * np.tan(np.deg2rad(1.0))
        for i in shown[~occluded_points(pixels[shown], points[shown, 2], model.size, reach=reach)]:
            column, row = np.floor((pixels[i] + 0.5 - grid.offset) / grid.size).astype(int)
            on_grid = 0 <= row < grid.rows and 0 <= column < grid.columns
            if on_grid and this.camera.free[row, column] and -points[i, 2] / away[i] < best[i]:
                best[i] = -points[i, 2] / away[i]
                found.view[i], found.pixel[i], found.distance[i] = number, pixels[i], away[i]
                found.row[i], found.column[i] = row, column
    return found


def random_views(count: int) -> list[CameraView]:
    bonnet = [(0.0, 90.0), (159.0, 80.0), (159.0, 119.0), (0.0, 119.0)]
    draws = [np.random.default_rng(number).normal(size=3) for number in range(count)]
    poses = [mounting(Rotation.from_rotvec(0.2 * draw), draw) for draw in draws]
    return [view(mounted=pose, matrix=SKEWED, own_body=[bonnet], patch=14) for pose in poses]


@pytest.mark.parametrize("count", [0, 1, 4001])
@pytest.mark.parametrize("views", [0, 1, 3])
def test_a_projection_is_that_of_numpy(count: int, views: int):
    rng = np.random.default_rng(count + views)
    points = rng.normal(size=(count, 3)) * (8, 6, 15)
    points[5::50] = np.nan
    seen_from = random_views(views)
    expected, found = plain(points, seen_from), project(points, seen_from)
    np.testing.assert_array_equal(found.view, expected.view)
    for name in ("pixel", "row", "column", "distance"):
        # BLAS may fuse a product with the sum that it goes into, or not, by machine.
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-9)
    if count > 1 and views:
        assert 100 < found.seen.sum() < count - 100
        features = [rng.normal(size=(8, 11, 5)).astype(np.float32) for _ in seen_from]
        gathered = found.gather(features)
        assert np.isnan(gathered[~found.seen]).all()
        mine = np.flatnonzero(found.seen)
        picked = np.array([features[found.view[i]][found.row[i], found.column[i]] for i in mine])
        np.testing.assert_array_equal(gathered[mine], picked)


def plain_occlusion(pixels, depth, reach):
    """Apply the definition to one point at a time, with cells of 2 px."""
    window = int(np.ceil(reach / 2))
    place = np.floor((pixels + 0.5) / 2).astype(int)
    answer = []
    for here, own in zip(place, depth, strict=True):
        nearer = place[depth < own - (0.06 * own + 0.3)] - here
        near = nearer[(nearer**2).sum(axis=1) <= window**2]
        if (near == 0).all(axis=1).any():
            answer.append(True)
            continue
        taken = np.zeros(SECTORS, bool)
        taken[np.round(np.arctan2(near[:, 1], near[:, 0]) / (2 * np.pi) * SECTORS).astype(int) % SECTORS] = True
        gaps = [len(run) for run in "".join("x" if t else "." for t in np.tile(taken, 2)).split("x")]
        answer.append(max(gaps) <= FREE)
    return np.array(answer)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), reach=st.floats(2, 12))
def test_occlusion_is_as_defined(seed, reach):
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(-0.5, 59.5, (80, 2))
    depth = rng.choice([3.0, 3.5, 8.0, 20.0], 80) * rng.uniform(0.95, 1.05, 80)
    np.testing.assert_array_equal(
        occluded_points(pixels, depth, (60, 60), reach=reach), plain_occlusion(pixels, depth, reach)
    )


@pytest.mark.parametrize("reach", [1.0, 9.0, 40.0])
def test_the_compiled_occlusion_is_the_plain_one(reach, monkeypatch):
    rng = np.random.default_rng(0)
    pixels = rng.uniform(-0.5, (79.5, 59.5), (2000, 2))
    depth = rng.choice([3.0, 3.5, 8.0, 20.0], 2000) * rng.uniform(0.95, 1.05, 2000)
    found = occluded_points(pixels, depth, (80, 60), reach=reach)
    monkeypatch.setattr(projection, "find_nearer", projection.find_nearer.plain)
    np.testing.assert_array_equal(found, occluded_points(pixels, depth, (80, 60), reach=reach))
    assert 0 < found.sum() < 2000


def test_points_far_outside_the_image_stay_in_the_z_buffer():
    pixels = np.array([[-1e6, 1e6], [1e6, -1e6], [0.0, 60.0]])
    found = occluded_points(pixels, np.array([20.0, 20.0, 3.0]), (80, 60), reach=9.0)
    assert found.tolist() == [True, False, False]
