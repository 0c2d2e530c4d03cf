"""Points in images: hand-worked answers, a moving vehicle, a wall, two cameras, and what is no number."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offpiste.core.errors import PerceptionError
from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Camera, Cloud, Lidar
from offpiste.logs.poses import Poses
from offpiste.perception.camera import PinholeCamera, make_pinhole_camera
from offpiste.perception.motion_compensation import inverse, points_in_world, transformed
from offpiste.perception.projection import CameraView, ProjectionSettings, project, project_to_pinhole
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource, LidarSource

AHEAD = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""`body_from_camera` of a camera at the pose point that looks ahead."""
MATRIX = np.array([[100.0, 0.0, 79.5], [0.0, 100.0, 59.5], [0.0, 0.0, 1.0]])


def camera(*, mounting=AHEAD, name="front", own_body=(), patch=10) -> PinholeCamera:
    """160x120 pixels, 100 px focal length, no distortion."""
    source = CameraSource(topic=name, own_body=own_body)
    return make_pinhole_camera(Camera(name, CameraModel(160, 120, MATRIX), mounting, source), patch)


def view(time=0.0, **options) -> CameraView:
    made = camera(**options)
    return CameraView(made, time, made.body_from_camera)


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


def test_what_is_behind_outside_or_no_number_is_not_seen():
    points = np.array([[-10.0, 0, 0], [10, 9, 0], [10, 0, 7], [np.nan, 0, 0], [np.inf, 0, 0], [0.1, 0, 0], [0, 0, 0]])
    found = project(points, [view()])
    assert not found.seen.any()
    assert np.isnan(found.pixel).all()
    assert np.isnan(found.distance).all()
    empty = project(np.zeros((0, 3)), [view()])
    assert len(empty.view) == 0
    assert not project(np.ones((3, 3)), []).seen.any()


def test_the_middle_of_the_first_pixel_is_the_origin():
    at = np.array([[-0.51, 0.0], [-0.49, 0.0], [159.49, 119.49], [159.51, 0.0]])
    rays = np.column_stack(((at - [79.5, 59.5]) / 100, np.ones(4)))
    found, pixels = project_to_pinhole(rays, CameraModel(160, 120, MATRIX))
    assert found.tolist() == [1, 2]
    np.testing.assert_allclose(pixels, at[1:3])


def test_features_are_those_of_the_patch():
    features = np.arange(12 * 16 * 2, dtype=np.float32).reshape(12, 16, 2)
    found = project(np.array([[10.0, 1.0, 2.0], [-1.0, 0.0, 0.0]]), [view()])
    gathered = found.gather([features])
    np.testing.assert_array_equal(gathered[0], features[4, 7])
    assert np.isnan(gathered[1]).all()


def test_a_moving_vehicle_is_compensated_between_scan_and_image():
    """A post at rest, scanned 0.1 s before the image at 10 m/s: seen 10 m away, it is 9 m away in the image."""
    poses, made = straight(10.0), camera()
    lidar = Lidar("top", np.eye(4), LidarSource(topic="top"))
    scan = Cloud(-0.1, "top", np.array([[10.0, 2.0, 0.0]]), None, np.ones(1))
    world = points_in_world(scan, lidar, poses)
    seen = CameraView(made, 0.0, poses.at(np.zeros(1))[0] @ made.body_from_camera)
    np.testing.assert_allclose(project(world, [seen]).pixel, [[79.5 - 100 * 2 / 9, 59.5]])
    ignored = project(world, [CameraView(made, 0.0, poses.at(np.array([-0.1]))[0] @ made.body_from_camera)])
    np.testing.assert_allclose(ignored.pixel, [[59.5, 59.5]])  # 2.2 px off


def test_a_sweep_is_unbent_while_the_vehicle_drives_and_turns():
    """Points of a wall at rest, each as the LiDAR saw it at its own moment."""
    poses = straight(12.0, yaw_rate=0.8)
    mounting = np.eye(4)
    mounting[:3, :3], mounting[:3, 3] = Rotation.from_euler("zy", (0.3, 0.1)).as_matrix(), (1.0, 0.2, 1.8)
    wall = np.column_stack((np.full(200, 30.0), np.linspace(-20, 20, 200), np.linspace(0, 3, 200)))
    offset = np.linspace(0, 0.1, 200)
    seen = np.stack(
        [
            transformed(point[None], inverse(matrix @ mounting))[0]
            for point, matrix in zip(wall, poses.at(0.2 + offset), strict=True)
        ]
    )
    lidar = Lidar("top", mounting, LidarSource(topic="top"))
    carried = points_in_world(Cloud(0.2, "top", seen, offset, np.ones(200)), lidar, poses)
    assert np.abs(carried - wall).max() < 0.005  # the poses' moments are rounded to 0.1 ms
    bent = points_in_world(Cloud(0.2, "top", seen, None, np.ones(200)), lidar, poses)
    assert np.linalg.norm(bent - wall, axis=1).max() > 1.0


def test_without_a_pose_points_are_unknown():
    poses = straight(1.0)
    lidar = Lidar("top", np.eye(4), LidarSource(topic="top"))
    scan = Cloud(0.95, "top", np.ones((2, 3)), np.array([0.0, 0.1]), np.ones(2))
    assert np.isnan(points_in_world(scan, lidar, poses)).any(axis=1).tolist() == [False, True]
    assert np.isnan(poses.at(np.array([1.5]))).all()


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
    assert project(np.concatenate((wall, behind)), [view()], ProjectionSettings(occlusion=False)).seen.all()


def test_of_two_cameras_the_one_that_looks_at_the_point_is_taken():
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    views = [view(), view(mounting=turned @ AHEAD, name="left", time=-0.1)]
    angles = np.deg2rad([-10, 15, 25, 60])
    points = 10 * np.column_stack((np.cos(angles), np.sin(angles), np.zeros(4)))
    assert project(points, views).view.tolist() == [0, 0, 1, 1]  # the middle lies at 20 degrees
    newest = ProjectionSettings(rule="newest")
    assert project(points, views, newest).view.tolist() == [0, 0, 0, 1]
    assert project(points, views[::-1], newest).view.tolist() == [1, 1, 1, 0]
    # What the better camera cannot see, the other one shows.
    wall = points[2] * 0.3
    assert project(np.stack((points[2], wall)), views).view.tolist() == [-1, 1]


def test_patches_of_the_vehicle_itself_show_nothing():
    hood = (((0.0, 100.0), (159.0, 100.0), (159.0, 119.0), (0.0, 119.0)),)
    points = np.array([[5.0, 0.0, -1.9], [5.0, 0.0, -2.1]])  # pixels 97.5 and 101.5
    assert project(points, [view(own_body=hood)]).seen.tolist() == [True, False]


def test_senseless_settings_are_refused():
    with pytest.raises(PerceptionError, match=r"reach 0\.0 deg.*give a reach"):
        ProjectionSettings(reach=0.0)
