"""Poses between samples: worked out by hand, and never across a gap."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from offpiste.logs.channel import Channel
from offpiste.logs.poses import Poses


def poses(time, position, orientation, max_gap=1.0):
    time = np.asarray(time, float)
    return Poses(
        Channel("position", "m", time, np.asarray(position, float)),
        Channel("orientation", "1", time, np.asarray(orientation, float)),
        max_gap,
    )


def yaw(degrees):
    return Rotation.from_euler("z", degrees, degrees=True).as_quat()


def test_half_way_is_half_the_way_and_half_the_turn():
    found = poses([0, 1], [[0, 0, 0], [2, 4, 6]], [yaw(0), yaw(90)]).at(np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(found[:, :3, 3], [[0, 0, 0], [1, 2, 3], [2, 4, 6]])
    np.testing.assert_allclose(found[1, :3, 0], [np.sqrt(0.5), np.sqrt(0.5), 0])
    np.testing.assert_allclose(found[:, 3], np.tile([0, 0, 0, 1], (3, 1)))


def test_the_sign_of_a_quaternion_means_nothing():
    one, other = (poses([0, 1], np.zeros((2, 3)), [yaw(10), sign * yaw(50)]) for sign in (1, -1))
    at = np.linspace(0, 1, 7)
    np.testing.assert_allclose(one.at(at), other.at(at), atol=1e-12)


def test_any_turn_is_as_scipys():
    time, rng = np.arange(6.0), np.random.default_rng(0)
    turns = Rotation.random(6, random_state=1)
    at = rng.uniform(0, 5, 50)
    found = poses(time, np.zeros((6, 3)), turns.as_quat(), 2.0).at(at)
    np.testing.assert_allclose(found[:, :3, :3], Slerp(time, turns)(at).as_matrix(), atol=1e-9)


def test_outside_and_across_a_gap_nothing_is_known():
    found = poses([0, 1, 5, 6], np.zeros((4, 3)), [yaw(0)] * 4).at(np.array([-0.1, 0.5, 3.0, 5.5, 6.1]))
    assert np.isnan(found).all(axis=(1, 2)).tolist() == [True, False, True, False, True]
    assert poses([0, 1], np.zeros((2, 3)), [yaw(0)] * 2).span == (0.0, 1.0)


def test_without_height_there_is_no_pose():
    from factories import small_rig
    from offpiste.errors import RigError
    from offpiste.logs.drive import Drive
    from offpiste.logs.poses import poses_from_drive

    flat = Channel("position", "m", np.arange(2.0), np.zeros((2, 2)))
    with pytest.raises(RigError, match=r"need positions with z"):
        poses_from_drive(Drive("x", small_rig(), {"position": flat}))
