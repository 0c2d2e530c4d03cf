"""Half turns to z up, against rotation matrices."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offpiste.logs.axes import to_z_up
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
