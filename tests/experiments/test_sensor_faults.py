"""Calibration errors change the cameras as requested, and nothing else."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.perturbed_sensors import Flaw, perturbed, stretch, turn
from offpiste.logs.measurements import Image
from sensor_bags import opened, record


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).magnitude()))


@pytest.mark.parametrize("degrees", [0.0, 0.5, 2.0, 90.0])
def test_a_rotation_has_the_requested_angle(degrees: float) -> None:
    assert angle_between(np.eye(4), turn(degrees, np.random.default_rng(1))) == pytest.approx(degrees, abs=1e-6)


def test_axes_point_everywhere() -> None:
    rng = np.random.default_rng(0)
    axes = np.array([Rotation.from_matrix(turn(1.0, rng)[:3, :3]).as_rotvec(degrees=True) for _ in range(2000)])
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0)
    np.testing.assert_allclose(axes.mean(axis=0), 0.0, atol=0.06)
    np.testing.assert_allclose(axes.T @ axes / len(axes), np.eye(3) / 3, atol=0.03)


def test_the_camera_is_turned_where_it_sits_and_all_else_stays(tmp_path: Path) -> None:
    log = opened(record(tmp_path / "drive.mcap"))
    before = log.cameras["front"].body_from_camera.copy()
    other = perturbed(log, Flaw(degrees=2.0, direction=7))
    after = other.cameras["front"].body_from_camera
    assert angle_between(before, after) == pytest.approx(2.0)
    np.testing.assert_array_equal(after[:3, 3], before[:3, 3])
    np.testing.assert_array_equal(log.cameras["front"].body_from_camera, before)
    assert other.lidars == log.lidars

    half = perturbed(log, Flaw(degrees=1.0, direction=7)).cameras["front"].body_from_camera
    assert angle_between(half, after) == pytest.approx(1.0)  # the same axis
    elsewhere = perturbed(log, Flaw(degrees=2.0, direction=8)).cameras["front"].body_from_camera
    assert angle_between(elsewhere, after) > 0.1


def test_images_are_believed_to_be_later_and_clouds_are_not(tmp_path: Path) -> None:
    log = opened(record(tmp_path / "drive.mcap"))
    other = perturbed(log, Flaw(late=0.05))
    before, after = list(log.stream()), list(other.stream())
    shift = {type(measured): [] for measured in before}
    by_kind = [sorted(found, key=lambda m: (isinstance(m, Image), m.time)) for found in (before, after)]
    for was, now in zip(*by_kind, strict=True):
        shift[type(was)].append(now.time - was.time)
    images = shift.pop(Image)
    np.testing.assert_allclose(images, 0.05, atol=1e-6)
    np.testing.assert_allclose(list(shift.values()), 0.0, atol=1e-9)
    np.testing.assert_allclose(other.stamps("front") - log.stamps("front"), 0.05, atol=1e-6)


def test_no_flaw_is_no_change(tmp_path: Path) -> None:
    log = opened(record(tmp_path / "drive.mcap"))
    camera, same = log.cameras["front"], perturbed(log, Flaw()).cameras["front"]
    np.testing.assert_array_equal(same.body_from_camera, camera.body_from_camera)
    assert same.source == camera.source


def test_poses_of_a_stretch_end_where_it_does(tmp_path: Path) -> None:
    log = opened(record(tmp_path / "drive.mcap"))
    first, _ = log.poses.span
    part = stretch(log, first + 0.2, first + 0.6)
    times = first + np.array([0.1, 0.25, 0.55, 0.7])
    known = np.isfinite(part.poses.at(times)).all(axis=(1, 2))
    np.testing.assert_array_equal(known, [False, True, True, False])
    np.testing.assert_allclose(part.poses.at(times[1:3]), log.poses.at(times[1:3]))
    assert log.poses.span[0] == first
