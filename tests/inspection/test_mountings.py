"""Mountings and delays of sensors in a world of planes, and parts of the vehicle in their view."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import textured_world as world
from offpiste.inspection.camera import check_camera
from offpiste.inspection.camera_mounting import estimate_rotation, matched
from offpiste.inspection.camera_place import estimate_place
from offpiste.inspection.estimated_mounting import EstimatedMounting
from offpiste.inspection.lidar import check_lidar
from offpiste.inspection.lidar_mounting import estimate_lidar
from offpiste.inspection.misfit import turned
from offpiste.inspection.own_body import check_own_body
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


TURN = np.deg2rad([0.8, -1.5, 1.2])


def as_planted(found, turn=(0, 0, 0), late=0.0, *, degrees=0.15, seconds=0.004):
    assert found is not None
    np.testing.assert_allclose(np.rad2deg(found.parameters[:3]), -np.rad2deg(turn), atol=degrees)
    assert abs(found.parameters[3] - late) < seconds
    assert (found.sigma[:3] < np.deg2rad(0.3)).all()
    assert found.sigma[3] < 0.01


@pytest.mark.parametrize(("turn", "late"), [((0, 0, 0), 0.0), (TURN, 0.0), ((0, 0, 0), 0.08)])
def test_lidar(turn, late):
    as_planted(check_lidar(world.lidar(turn), world.scans(late=late), world.poses()), turn, late)


@pytest.mark.parametrize(("turn", "late"), [((0, 0, 0), 0.0), (TURN, 0.0), ((0, 0, 0), 0.08)])
def test_camera(turn, late):
    found = check_camera(world.camera(turn), world.images(late=late), world.lidar(), world.scans(), world.poses())
    as_planted(found, turn, late, degrees=0.25, seconds=0.008)


def test_straight_at_constant_speed_leaves_the_delay_unknown():
    found = check_lidar(world.lidar(), world.scans(late=0.08, straight=True), world.poses(straight=True))
    assert found is not None
    assert found.sigma[3] > 0.05
    assert np.abs(np.rad2deg(found.parameters[1:3])).max() < 0.2


def test_a_camera_is_checked_with_its_lidar_corrected():
    turn = np.deg2rad([0.0, 3.0, 0.0])
    wrong, scans, images = world.lidar(turn), world.scans(), world.images()
    right = check_camera(world.camera(), images, wrong, scans, world.poses(), np.append(-turn, 0.0))
    as_planted(right, degrees=0.25, seconds=0.008)


def test_nothing_to_compare():
    assert check_lidar(world.lidar(), world.scans()[:4], world.poses()) is None
    assert check_camera(world.camera(), world.images(), world.lidar(), [], world.poses()) is None
    flat = [type(image)(image.time, np.full_like(image.pixels, 90)) for image in world.images()]
    assert check_camera(world.camera(), flat, world.lidar(), world.scans(), world.poses()) is None


WHEELS = ((1.0, 0.7), (1.0, -0.7), (-1.0, 0.7), (-1.0, -0.7))


def with_part(scans, low, high):
    """Scans with fifty returns in a box of the body frame."""
    mounting = world.lidar().body_from_lidar
    part = np.random.default_rng(0).uniform(low, high, (50, 3))
    seen = (part - mounting[:3, 3]) @ mounting[:3, :3]
    return [
        replace(s, points=np.concatenate((s.points, seen)), which=np.append(s.which, np.zeros(50, int))) for s in scans
    ]


def found(scans, poses=None, **source):
    lidar = world.lidar()
    lidar = replace(lidar, source=type(lidar.source)(lidar.source.topic, **source))
    return check_own_body(lidar, scans, poses or world.poses(), WHEELS)


def test_what_stands_is_the_vehicle():
    scans = world.scans()
    assert found(scans) == []
    for low, high in (((-0.5, -0.5, 1.0), (0.5, 0.5, 1.2)), ((0.9, -1.5, 1.0), (1.1, -1.3, 1.4))):  # a roof, a mirror
        (finding,) = found(with_part(scans, low, high))
        assert (finding.where, finding.what) == ("top", "sees the vehicle itself")
        ((cure,),) = finding.cures
        assert cure.key == "lidars.top.own_body"
        assert (np.array(cure.value[0]) <= low).all()
        assert (np.array(cure.value[1]) >= high).all()
