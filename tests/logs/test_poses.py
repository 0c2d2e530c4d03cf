"""Interpolation of poses, never across gaps and jumps, and detection of jumps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from factories import MemoryLog, small_rig
from offpiste.core.errors import RigError
from offpiste.dataset.resample import extract_rows
from offpiste.dataset.wheel_passes import find_passes
from offpiste.dataset.window_starts import window_starts
from offpiste.logs import read_drive
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.logs.poses import Poses, find_jumps, poses_from_drive
from offpiste.rig.rig import load_rig

TIME = np.arange(0, 20, 0.02)


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


def test_outside_and_across_a_gap_nothing_is_known():
    found = poses([0, 1, 5, 6], np.zeros((4, 3)), [yaw(0)] * 4).at(np.array([-0.1, 0.5, 3.0, 5.5, 6.1]))
    assert np.isnan(found).all(axis=(1, 2)).tolist() == [True, False, True, False, True]
    assert poses([0, 1], np.zeros((2, 3)), [yaw(0)] * 2).span == (0.0, 1.0)


def test_without_height_there_is_no_pose():
    flat = Channel("position", "m", np.arange(2.0), np.zeros((2, 2)))
    with pytest.raises(RigError, match=r"need positions with z"):
        poses_from_drive(Drive("x", small_rig(), {"position": flat}))


def straight(speed=5.0, time=TIME) -> np.ndarray:
    return np.column_stack((speed * time, np.zeros((len(time), 2))))


def position(values, time=TIME) -> Channel:
    return Channel("position", "m", time, values)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_step_aside_back_or_up_is_a_jump(axis):
    place = straight()
    place[500:, axis] -= 3.0
    np.testing.assert_allclose(find_jumps(position(place)), [[TIME[499], TIME[500]]])


def test_small_corrections_and_hard_braking_are_none():
    place = straight()
    place[500:, 1] += 0.9
    assert len(find_jumps(position(place))) == 0
    speed = np.clip(15 - 9 * (TIME - 5), 0, 15)
    braking = np.column_stack((np.cumsum(speed) * 0.02, np.zeros((len(TIME), 2))))
    assert len(find_jumps(position(braking))) == 0


def test_a_long_gap_explains_what_a_vehicle_can_drive_in_it():
    kept = (TIME < 8) | (TIME > 11)
    place = straight()
    assert len(find_jumps(position(place[kept], TIME[kept]))) == 0
    place[TIME > 11, 1] += 150.0
    assert len(find_jumps(position(place[kept], TIME[kept]))) == 1


def test_a_turn_on_the_spot_is_a_jump_too():
    yaw = 0.5 * TIME
    yaw[300:] += np.deg2rad(40)
    flips = np.where(TIME < 9, 1, -1)[:, None]  # q and -q turn alike
    turns = Channel("orientation", "1", TIME, Rotation.from_euler("z", yaw[:, None]).as_quat() * flips)
    np.testing.assert_allclose(find_jumps(position(straight()), turns), [[TIME[299], TIME[300]]])
    wrapped = Channel("yaw", "rad", TIME, ((yaw + np.pi) % (2 * np.pi) - np.pi)[:, None])
    assert np.ptp(wrapped.values) > 6
    np.testing.assert_allclose(find_jumps(position(straight()), wrapped), [[TIME[299], TIME[300]]])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), at=st.integers(30, 950), far=st.floats(1.5, 50.0))
def test_of_any_smooth_drive_only_the_planted_jump_is_found(seed, at, far):
    rng = np.random.default_rng(seed)
    speed, yaw = 6 + 3 * np.sin(0.5 * TIME + rng.uniform(0, 6)), np.cumsum(0.02 * np.sin(0.3 * TIME))
    place = np.cumsum(0.02 * speed[:, None] * np.column_stack((np.cos(yaw), np.sin(yaw), 0 * yaw)), axis=0)
    place += rng.normal(0, 0.02, place.shape)
    assert len(find_jumps(position(place))) == 0
    away = rng.normal(size=3)
    # Aside: along the path, a jump back cancels out against the way that was driven.
    away[:2] -= away[:2] @ place[at, :2] / (place[at, :2] @ place[at, :2]) * place[at, :2]
    place[at:] += (far + 0.5) * away / np.linalg.norm(away)
    assert find_jumps(position(place)).tolist() == [[TIME[at - 1], TIME[at]]]


def test_between_the_samples_of_a_jump_no_pose_is_known():
    place = straight()
    place[500:, 1] += 3.0
    still = Channel("orientation", "1", TIME, np.tile([0.0, 0, 0, 1], (len(TIME), 1)))
    poses = Poses(position(place), still, 0.5, find_jumps(position(place)))
    found = poses.at(np.array([9.98, 9.99, 10.0]))
    assert np.isnan(found).all(axis=(1, 2)).tolist() == [False, True, False]
    assert [poses.stretch(t) for t in (0.0, 9.98, 10.0, 19.0)] == [0, 0, 1, 1]


def test_no_window_reaches_across():
    place = straight()
    place[500:, 1] += 3.0
    still = {"qx": 0 * TIME, "qy": 0 * TIME, "qz": 0 * TIME, "qw": 1 + 0 * TIME}
    fields = dict(zip("xyz", place.T, strict=True)) | still
    zero = {"throttle": 0 * TIME, "brake": 0 * TIME, "steer": 0 * TIME}
    log = MemoryLog(odometry=(TIME, fields), pedals=(TIME, zero), steering=(TIME, zero))
    rows = extract_rows(drive_from_log(log, small_rig()))
    lost = rows.time[~rows.valid & (rows.time > 1)]
    assert (lost > 9.5).all()
    assert (lost < 10.5).all()
    assert np.abs(rows.state[rows.valid, 4]).max() < 0.01  # no sideways speed out of a jump
    starts = window_starts(rows.valid, history=10, horizon=250)
    assert not ((rows.time[starts] > 4.9) & (rows.time[starts] < 10.3)).any()


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


def test_the_recorded_drives_have_none(data_folder):
    drives = [(path, "tartandrive2") for path in sorted((data_folder / "tartandrive2" / "drives").glob("*"))]
    drives += [(path, "kitti") for path in sorted((data_folder / "kitti_raw" / "2011_09_26").glob("*_sync"))]
    assert drives
    for path, rig in drives:
        drive = read_drive(path, load_rig(rig))
        assert len(find_jumps(drive.channels["position"], drive.channels["orientation"])) == 0, path.name
