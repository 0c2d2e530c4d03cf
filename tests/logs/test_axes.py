"""Half turns to z up, against rotation matrices."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offpiste.logs.channel import to_z_up, turning_sign
from offpiste.rig.channels import ChannelSource

HALF = np.diag([1.0, -1.0, -1.0])
SOURCE = {frame: ChannelSource(fields=("x", "y", "z"), frame=frame) for frame in ("", "world", "body")}


@pytest.mark.parametrize(("axes", "world", "body"), [("body down", 0, 1), ("world down", 1, 0), ("ned", 1, 1)])
def test_orientations_and_vectors_turn_as_their_matrices_do(axes: str, world: int, body: int) -> None:
    generator = np.random.default_rng(0)
    quaternion = Rotation.random(20, random_state=1).as_quat()
    left, right = (HALF if turn else np.eye(3) for turn in (world, body))
    turned = Rotation.from_quat(to_z_up("orientation", SOURCE[""], quaternion, axes)).as_matrix()
    np.testing.assert_allclose(turned, left @ Rotation.from_quat(quaternion).as_matrix() @ right, atol=1e-12)
    vectors = generator.standard_normal((20, 3))
    for name, frame, matrix in (
        ("position", "", left),
        ("linear_velocity", "world", left),
        ("linear_velocity", "body", right),
        ("angular_velocity", "body", right),
    ):
        np.testing.assert_allclose(to_z_up(name, SOURCE[frame], vectors, axes), vectors @ matrix.T, atol=1e-12)


def test_a_heading_that_counts_from_north_clockwise_is_turned() -> None:
    heading = np.array([[0.3], [-1.0]])
    assert (to_z_up("yaw", SOURCE[""], heading, "ned") == -heading).all()
    assert (to_z_up("yaw", SOURCE[""], heading, "body down") == heading).all()
    assert (to_z_up("throttle", SOURCE[""], heading, "ned") == heading).all()


def test_an_offset_turns_to_the_left_by_its_sign() -> None:
    yaw = np.array([[0.2]])
    for axes in ("z up", "body down", "world down", "ned"):
        turned = to_z_up("yaw", SOURCE[""], yaw + 0.1, axes) - to_z_up("yaw", SOURCE[""], yaw, axes)
        assert turned == pytest.approx(0.1 * turning_sign("yaw", axes))
        before, after = (Rotation.from_euler("z", angle).as_quat()[None] for angle in (0.2, 0.3))
        before, after = (to_z_up("orientation", SOURCE[""], each, axes) for each in (before, after))
        about_body = (Rotation.from_quat(before).inv() * Rotation.from_quat(after)).as_rotvec()[0, 2]
        assert about_body == pytest.approx(0.1 * turning_sign("orientation", axes))


def test_latitude_and_longitude_have_no_axes_and_are_laid_into_the_world_of_the_others() -> None:
    """Where the log's world is north, east, down, all else becomes north, west, up; the height is up as it is."""
    east_north_up = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, -6.0]])
    north_west_up = np.array([[2.0, -1.0, 3.0], [5.0, 4.0, -6.0]])
    source = ChannelSource(fields=("lat", "lon", "height"), unit="lat lon")
    for axes in ("z up", "body down", "world down", "ned"):
        expected = north_west_up if axes in ("world down", "ned") else east_north_up
        assert (to_z_up("position", source, east_north_up, axes) == expected).all()
        assert (to_z_up("position", source, east_north_up[:, :2], axes) == expected[:, :2]).all()
