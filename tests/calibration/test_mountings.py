"""Mountings and delays of sensors in a world of planes, and parts of the vehicle in their view."""

from dataclasses import replace
from unittest.mock import Mock, create_autospec

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import textured_world as world
from offpiste.calibration.camera import check_camera
from offpiste.calibration.camera_place import estimate_place
from offpiste.calibration.image_motion import estimate_rotation, matched
from offpiste.calibration.lidar import check_lidar, estimate_lidar
from offpiste.calibration.misfit import turned
from offpiste.calibration.mountings import EstimatedMounting, estimated
from offpiste.calibration.own_body import find_own_body
from offpiste.calibration.samples import Gathered
from offpiste.inspection.sensors import check_own_body
from offpiste.logs.sensor_log import SensorLog
from offpiste.rig.sensors import OPTICAL, LidarSource

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
    mounting, misfit = found
    assert angle(mounting, world.BODY_FROM_LIDAR) < 0.5
    assert (misfit.sigma[:3] < np.deg2rad(0.5)).all()
    np.testing.assert_allclose(mounting[:2, 3], world.BODY_FROM_LIDAR[:2, 3], atol=0.15)


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


def camera_fit(camera, *, images=None, lidar=None, lidar_parameters=None, scans=None):
    """Fit of a camera to surfaces seen in its images and in scans of a LiDAR."""
    images, scans = world.images() if images is None else images, world.scans() if scans is None else scans
    return check_camera(camera, images, lidar or world.lidar(), scans, world.poses(), lidar_parameters)


def test_the_place_of_a_camera():
    matches = matched(world.camera(), world.images()[:12])
    given = turned(world.BODY_FROM_CAMERA, np.array([0, 0, 0, 0, 0.5, -0.4, -1.0]))
    found = estimate_place(given, matches, world.lidar(), FEW, world.poses())
    assert found is not None
    np.testing.assert_allclose(found.parameters[6], 1.0, atol=0.1)


def test_a_lidar_and_a_camera_without_a_place_from_guesses_far_off():
    lidar, camera = wrong_lidar(FAR), world.camera(FAR)
    given = camera.camera.body_from_camera.copy()
    given[:3, 3] = 0
    camera = replace(camera, camera=replace(camera.camera, body_from_camera=given))
    sensors = create_autospec(SensorLog, instance=True, lidars={"top": lidar}, poses=world.poses(), rig=Mock())
    sensors.rig.vehicle.wheel_positions = WHEELS
    gathered = Gathered({"top": world.scans()}, {"front": world.images()})
    places = {"top": (lidar.body_from_lidar, True), "front": (given, False)}
    top, front = estimated(sensors, {"front": camera}, gathered, places)
    for one, true in ((top, world.BODY_FROM_LIDAR), (front, world.BODY_FROM_CAMERA)):
        assert one.refused == ""
        assert angle(one.mounting, true) < 0.3
        np.testing.assert_allclose(one.mounting[:3, 3], true[:3, 3], atol=0.1)
        assert one.after < 0.5 * one.before
    assert np.isnan(top.place_sigma[2])  # of the guess
    (unseen,) = estimated(sensors, {}, replace(gathered, scans={"top": world.scans()[:2]}), places)
    assert unseen.refused == "top: the vehicle hardly moves while it measures: its heading is not observable"


def test_rig_line_angles_and_refusal():
    mounting = np.eye(4)
    mounting[:3, :3] = Rotation.from_euler("ZYX", (90, 10, 5), degrees=True).as_matrix() @ OPTICAL
    key, sigma = "cameras.left.body_from_camera", (0.01, 0.01, 0.01)
    one = EstimatedMounting("left", key, True, mounting, mounting, 3.0, 0.4, "px", sigma=sigma)
    np.testing.assert_allclose(np.rad2deg(one.roll_pitch_yaw), [5, 10, 90], atol=1e-9)
    assert str(one.edit).startswith("cameras.left.body_from_camera = { position = [0.0, 0.0, 0.0], orientation = [")
    assert str(one.__rich__()).splitlines() == [
        "left: its mounting is estimated, 0.0 degrees from the guess",
        "   seen: roll 5.00 ± 0.57, pitch 10.00 ± 0.57, yaw 90.00 ± 0.57 degrees; x 0.00 (the guess's), y 0.00 (the "
        "guess's), z 0.00 (the guess's) m; features lie off their epipolar lines by 0.4 px (median), 3 before",
        f"   fix: {one.edit}",
    ]
    refused = replace(one, refused="the drive is straight: yaw of left is not observable")
    assert refused.edit is None
    assert f"could not be estimated\n   seen: {refused.refused}" in str(refused.__rich__())
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
    found = camera_fit(world.camera(turn), images=world.images(late=late))
    as_planted(found, turn, late, degrees=0.15, seconds=0.004)


def test_straight_at_constant_speed_leaves_the_delay_unknown():
    found = check_lidar(world.lidar(), world.scans(late=0.08, straight=True), world.poses(straight=True))
    assert found is not None
    assert found.sigma[3] > 0.05
    assert np.abs(np.rad2deg(found.parameters[1:3])).max() < 0.2


def test_a_camera_is_checked_with_its_lidar_corrected():
    turn = np.deg2rad([0.0, 3.0, 0.0])
    right = camera_fit(world.camera(), lidar=world.lidar(turn), lidar_parameters=np.append(-turn, 0.0))
    as_planted(right, degrees=0.25, seconds=0.008)


def test_nothing_to_compare():
    assert check_lidar(world.lidar(), world.scans()[:4], world.poses()) is None
    assert camera_fit(world.camera(), scans=[]) is None
    flat = [type(image)(image.time, np.full_like(image.pixels, 90)) for image in world.images()]
    assert camera_fit(world.camera(), images=flat) is None


WHEELS = ((1.0, 0.7), (1.0, -0.7), (-1.0, 0.7), (-1.0, -0.7))


def with_part(scans, low, high):
    """Scans with fifty returns in a box of the body frame."""
    mounting = world.lidar().body_from_lidar
    part = np.random.default_rng(0).uniform(low, high, (50, 3))
    seen = (part - mounting[:3, 3]) @ mounting[:3, :3]
    return [
        replace(s, points=np.concatenate((s.points, seen)), which=np.append(s.which, np.zeros(50, int))) for s in scans
    ]


def test_what_stands_is_the_vehicle():
    scans, poses, known = world.scans(), world.poses(), [[-1.0, -1.0, 0.5], [1.0, 1.0, 1.0]]
    assert find_own_body(world.lidar(), scans, poses, WHEELS) is None
    boxed = replace(world.lidar(), source=LidarSource("/points", own_body=known))
    for low, high in (((-0.5, -0.5, 1.0), (0.5, 0.5, 1.2)), ((0.9, -1.5, 1.0), (1.1, -1.3, 1.4))):  # a roof, a mirror
        for lidar in (world.lidar(), boxed):
            found = find_own_body(lidar, with_part(scans, low, high), poses, WHEELS)
            assert found is not None
            assert found.returns == pytest.approx(50, abs=5)
            assert (found.box[0] <= low).all()
            assert (found.box[1] >= high).all()
        assert (found.box[0] <= known[0]).all()
        assert (found.box[1] >= known[1]).all()
        gathered = Gathered({"top": with_part(scans, low, high)}, {})
        (finding,) = check_own_body(world.lidar(), gathered, poses, WHEELS)
        assert (finding.where, finding.what) == ("top", "sees the vehicle itself")
        assert finding.cures[0][0].key == "lidars.top.own_body"
