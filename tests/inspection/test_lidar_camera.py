"""Planted turns and delays are found where motion tells them, in a world made of planes."""

import numpy as np
import pytest

import textured_world as world
from offpiste.inspection.camera import check_camera
from offpiste.inspection.lidar import check_lidar

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


def test_noise_of_the_poses_does_not_pass_for_motion():
    """Differences over a few ms did: the fit of a turned and late camera then ended at half of its delay."""
    noisy = world.poses(noise=np.deg2rad(0.05))
    found = check_camera(world.camera(TURN), world.images(late=0.08), world.lidar(), world.scans(), noisy)
    as_planted(found, TURN, 0.08, degrees=0.35, seconds=0.01)


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


def test_a_lidar_that_stamps_late_is_corrected_too():
    late = world.scans(late=0.1)
    right = check_camera(world.camera(), world.images(), world.lidar(), late, world.poses(), np.array([0, 0, 0, 0.1]))
    as_planted(right, degrees=0.25, seconds=0.008)


def test_nothing_to_compare():
    assert check_lidar(world.lidar(), world.scans()[:4], world.poses()) is None
    assert check_camera(world.camera(), world.images(), world.lidar(), [], world.poses()) is None
    flat = [type(image)(image.time, np.full_like(image.pixels, 90)) for image in world.images()]
    assert check_camera(world.camera(), flat, world.lidar(), world.scans(), world.poses()) is None
