"""Projection by compiled loops against plain NumPy: one and several views, both rules, masks, occlusion, no points."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offpiste.logs.measurements import Camera
from offpiste.perception.camera import make_pinhole_camera
from offpiste.perception.motion_compensation import inverse, transformed
from offpiste.perception.occlusion import occluded_points
from offpiste.perception.projection import (
    NEAREST,
    CameraView,
    Projection,
    ProjectionSettings,
    project,
    project_to_pinhole,
)
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource

MATRIX = np.array([[90.0, 0.3, 79.5], [0.0, 110.0, 59.5], [0.0, 0.0, 1.0]])


def plain_pinhole(points: np.ndarray, pinhole: CameraModel) -> tuple[np.ndarray, np.ndarray]:
    matrix = pinhole.matrix
    ahead = np.flatnonzero(points[:, 2] > NEAREST)
    x, y, z = points[ahead].T
    pixels = np.stack(
        (matrix[0, 0] * x / z + matrix[0, 1] * y / z + matrix[0, 2], matrix[1, 1] * y / z + matrix[1, 2]), axis=1
    )
    inside = ((pixels > -0.5) & (pixels < np.array(pinhole.size) - 0.5)).all(axis=1)
    return ahead[inside], pixels[inside]


def plain(points_world: np.ndarray, views: list[CameraView], settings: ProjectionSettings) -> Projection:
    n = len(points_world)
    view, pixel, distance = np.full(n, -1), np.full((n, 2), np.nan), np.full(n, np.nan)
    row, column, best = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.full(n, np.inf)
    for index, this in enumerate(views):
        points, model = transformed(points_world, inverse(this.world_from_camera)), this.camera.model
        result, at = plain_pinhole(points, model)
        if settings.occlusion:
            reach = float(model.matrix[0, 0]) * np.tan(np.deg2rad(settings.reach))
            occluded = occluded_points(at, points[result, 2], model.size, reach=reach)
            result, at = result[~occluded], at[~occluded]
        r, c, inside = this.camera.grid.cells(at)
        inside &= this.camera.free[r, c]
        result, at, r, c = result[inside], at[inside], r[inside], c[inside]
        far = np.linalg.norm(points[result], axis=1)
        cost = -points[result, 2] / far if settings.rule == "centre" else np.full(len(result), -this.time)
        better = cost < best[result]
        chosen = result[better]
        best[chosen], view[chosen], distance[chosen] = cost[better], index, far[better]
        pixel[chosen], row[chosen], column[chosen] = at[better], r[better], c[better]
    return Projection(view, pixel, row, column, distance)


def random_views(count: int) -> list[CameraView]:
    views = []
    for number in range(count):
        source = CameraSource(topic="front", own_body=[[(0.0, 90.0), (159.0, 80.0), (159.0, 119.0), (0.0, 119.0)]])
        camera = make_pinhole_camera(Camera("front", CameraModel(160, 120, MATRIX), np.eye(4), source), 14)
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(np.random.default_rng(number).normal(size=3) * 0.2).as_matrix()
        pose[:3, 3] = np.random.default_rng(number).normal(size=3)
        views.append(CameraView(camera, 0.1 * (number % 2), pose))
    return views


@pytest.mark.parametrize("count", [0, 1, 4001])
@pytest.mark.parametrize("views", [0, 1, 3])
@pytest.mark.parametrize(
    "settings",
    [ProjectionSettings(), ProjectionSettings(rule="newest"), ProjectionSettings(occlusion=False)],
    ids=lambda one: f"{one.rule}-{one.occlusion}",
)
def test_a_projection_is_that_of_numpy(count: int, views: int, settings: ProjectionSettings):
    rng = np.random.default_rng(count + views)
    points = rng.normal(size=(count, 3)) * (8, 6, 15)
    points[5::50] = np.nan
    seen_from = random_views(views)
    expected, found = plain(points, seen_from, settings), project(points, seen_from, settings)
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


def test_pixels_of_a_pinhole_are_those_of_numpy():
    points = np.random.default_rng(0).normal(size=(5000, 3)) * (3, 3, 4)
    points[::7] = np.nan
    pinhole = CameraModel(160, 120, MATRIX)
    for one, other in zip(project_to_pinhole(points, pinhole), plain_pinhole(points, pinhole), strict=True):
        np.testing.assert_array_equal(one, other)
