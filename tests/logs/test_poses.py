"""Interpolation of poses, never across gaps and jumps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from factories import small_rig
from offpiste.core.errors import RigError
from offpiste.dataset.wheel_passes import find_passes
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.logs.poses import Poses, poses_from_drive


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
    given = poses([0, 1], [[0, 0, 0], [2, 4, 6]], [yaw(0), yaw(90)])
    found = given.at(np.array([0.0, 0.5, 1.0]))
    assert given.span == (0.0, 1.0)
    np.testing.assert_allclose(found[:, :3, 3], [[0, 0, 0], [1, 2, 3], [2, 4, 6]])
    np.testing.assert_allclose(found[1, :3, 0], [np.sqrt(0.5), np.sqrt(0.5), 0])
    np.testing.assert_allclose(found[:, 3], np.tile([0, 0, 0, 1], (3, 1)))


def plain(given: Poses, at: np.ndarray) -> np.ndarray:
    """Return `Poses.at` computed by NumPy and SciPy, one time after the other."""
    found = np.full((len(at), 4, 4), np.nan)
    between = np.concatenate((given.jumps, given.unknown))
    for n, moment in enumerate(at):
        place = given.position.linear(np.array([moment]), max_gap=given.max_gap)[0]
        known = given.orientation.covered(np.array([moment]), given.max_gap)[0] and np.isfinite(place).all()
        if known and not ((between[:, 0] < moment) & (moment < between[:, 1])).any():
            turn = Slerp(given.orientation.time, Rotation.from_quat(given.orientation.values))(moment)
            found[n] = np.block([[turn.as_matrix(), place[:, None]], [np.zeros(3), 1]])
    return found


@pytest.mark.parametrize("seed", range(5))
def test_the_loop_gives_what_numpy_and_scipy_do(seed: int):
    rng = np.random.default_rng(seed)
    stamps = [np.sort(rng.uniform(0, 20, count)) for count in (60, 45)]
    turns = Rotation.random(45, random_state=seed).as_quat() * rng.choice([-1, 1], (45, 1))
    turns[20:25] = turns[20]  # stands still
    channels = Channel("position", "m", stamps[0], rng.normal(0, 1e3, (60, 3))), Channel("o", "1", stamps[1], turns)
    given = Poses(*channels, max_gap=1.0, jumps=np.array([[3.0, 4.0]]), unknown=np.array([[7.0, 7.5], [12.0, 12.1]]))
    at = np.concatenate((rng.uniform(-1, 21, 500), *stamps, [3.0, 4.0]))
    expected = plain(given, at)
    unknown = np.isnan(expected).all(axis=(1, 2))
    assert 30 < unknown.sum() < len(at) - 100
    np.testing.assert_allclose(given.at(at), expected, atol=1e-9)


def test_quaternions_of_zeros_are_no_pose():
    found = poses([0, 1, 2], np.zeros((3, 3)), [yaw(0), np.zeros(4), yaw(0)]).at(np.array([0.5, 1.0, 1.5]))
    assert np.isnan(found).all()


def test_without_height_there_is_no_pose():
    flat = Channel("position", "m", np.arange(2.0), np.zeros((2, 2)))
    with pytest.raises(RigError, match=r"need positions with z"):
        poses_from_drive(Drive("x", small_rig(), {"position": flat}))


def test_passes_are_watched_within_one_stretch_only():
    time = np.arange(0, 10, 0.1)
    xy = np.column_stack((2 * time, np.zeros(len(time))))
    wheels = np.repeat(xy[:, None], 4, axis=1)
    free = find_passes(time, xy, wheels, resolution=0.2)
    cut = find_passes(time, xy, wheels, resolution=0.2, jumps=time[[49, 50]][None])
    np.testing.assert_array_equal(free.contact, cut.contact)
    early, late = cut.contact < time[50], cut.contact >= time[50]
    assert (cut.end[early] == time[50]).all()
    assert (cut.approach[late] == time[50]).all()
    assert (cut.approach[early] == free.approach[early]).all()
    assert np.isinf(cut.end[late]).all()


def test_a_pass_ends_at_a_jump_and_begins_anew():
    time = np.arange(6) * 0.1
    still = np.zeros((6, 2))
    found = find_passes(time, still, np.zeros((6, 4, 2)), resolution=0.2, jumps=np.array([[time[2], time[4]]]))
    assert found.contact.tolist() == [time[0], time[4]]
    assert found.end.tolist() == [time[4], np.inf]
    assert found.index[:, 0].tolist() == [0, 0, 0, -1, 1, 1]  # between the two, the place is unknown
