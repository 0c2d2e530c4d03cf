"""Mountings are found from guesses far off, in a world made of planes; what a drive does not show is refused."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import textured_world as world
from offpiste.inspection.camera_mounting import estimate_rotation, matched
from offpiste.inspection.camera_place import estimate_place
from offpiste.inspection.draft_sensors import looks
from offpiste.inspection.estimated_mounting import EstimatedMounting
from offpiste.inspection.lidar_mounting import estimate_lidar, ground
from offpiste.inspection.misfit import turned
from offpiste.rig.sensors import OPTICAL

FAR = np.deg2rad([6.0, -7.0, 14.0])

FEW = [replace(scan, which=scan.which[::4], points=scan.points[::4]) for scan in world.scans()[:10]]
"""Scans of five seconds, thinned."""


def angle(one, other):
    """Between two mountings [deg]."""
    return np.rad2deg(Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).magnitude())


def wrong_lidar(turn, shift=(0.0, 0.0)):
    given = world.lidar(turn)
    moved = given.body_from_lidar.copy()
    moved[:2, 3] += shift
    return replace(given, body_from_lidar=moved)


def test_lidar_from_a_guess_far_off():
    turn = np.deg2rad([6.0, -7.0, 140.0])
    found = estimate_lidar(wrong_lidar(turn, (0.3, -0.2)), FEW, world.poses())
    assert not isinstance(found, str)
    assert angle(found.body_from_lidar, world.BODY_FROM_LIDAR) < 0.5
    assert (found.misfit.sigma[:3] < np.deg2rad(0.5)).all()
    np.testing.assert_allclose(found.body_from_lidar[:2, 3], world.BODY_FROM_LIDAR[:2, 3], atol=0.15)


def test_the_ground_levels_a_lidar():
    given, scan = wrong_lidar(FAR), world.scans()[0]
    normal = ground(scan, given, np.random.default_rng(0))
    assert normal is not None
    # The body itself rolls and pitches by some 3 degrees in one scan.
    np.testing.assert_allclose(world.BODY_FROM_LIDAR[:3, :3] @ normal, [0, 0, 1], atol=0.08)
    assert (
        ground(replace(scan, points=scan.points[:50], which=scan.which[:50]), given, np.random.default_rng(0)) is None
    )


def test_lidar_at_a_standstill_is_refused():
    still = world.scans()[:1] * 10
    scans = [replace(scan, time=scan.time + 0.5 * k) for k, scan in enumerate(still)]
    poses = world.poses()
    stay = replace(poses, position=replace(poses.position, values=np.zeros_like(poses.position.values)))
    assert "hardly moves" in str(estimate_lidar(world.lidar(), scans, stay))


def test_camera_from_a_guess_far_off():
    camera = world.camera(FAR)
    matches = matched(camera, world.images()[:12])
    found = estimate_rotation(camera.camera.body_from_camera, matches, world.poses())
    assert not isinstance(found, str)
    assert angle(found[0], world.BODY_FROM_CAMERA) < 1.0


def test_camera_in_the_dark_is_refused():
    dark = [replace(image, pixels=np.full_like(image.pixels, 9)) for image in world.images()]
    found = estimate_rotation(world.BODY_FROM_CAMERA, matched(world.camera(), dark), world.poses())
    assert "too few pairs" in str(found)


def test_the_place_of_a_camera():
    matches = matched(world.camera(), world.images()[:12])
    given = turned(world.BODY_FROM_CAMERA, np.array([0, 0, 0, 0, 0.5, -0.4, -1.0]))
    found = estimate_place(given, matches, world.lidar(), FEW, world.poses())
    assert found is not None
    np.testing.assert_allclose(found.parameters[6], 1.0, atol=0.1)


def test_rig_line_angles_and_refusal():
    mounting = np.eye(4)
    mounting[:3, :3] = Rotation.from_euler("ZYX", (90, 10, 0), degrees=True).as_matrix() @ OPTICAL
    sigma, unknown = np.full(3, 0.01), np.full(3, np.nan)
    one = EstimatedMounting(
        "left", "cameras.left.body_from_camera", True, mounting, mounting, sigma, unknown, 3.0, 0.4, "px"
    )
    np.testing.assert_allclose(np.rad2deg(one.roll_pitch_yaw), [0, 10, 90], atol=1e-9)
    assert str(one.edit).startswith("cameras.left.body_from_camera = { position = [0.0, 0.0, 0.0], orientation = [")
    assert one.finding().cures == ((one.edit,),)
    refused = replace(one, refused="the drive is straight: yaw of left is not observable")
    assert refused.edit is None
    assert refused.finding().severity == "warning"
    assert refused.as_dict()["position"] is None


def test_looks_by_name():
    named = ["front", "left", "camera_right", "rear_cam", "stereo_left", "top", "upright"]
    assert [looks(name) for name in named] == ["forward", "left", "right", "back", "forward", "forward", "forward"]
