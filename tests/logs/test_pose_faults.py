"""Faults of a drive's pose: dropped samples, jumps, and estimates that exclude them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factories import small_log, small_rig
from offpiste.dataset.resample import extract_rows
from offpiste.dataset.window_starts import window_starts
from offpiste.inspection.pose_samples import check_faults
from offpiste.logs.drive import Drive, drive_from_log, read_drive
from offpiste.logs.motion import across_jumps
from offpiste.logs.poses import poses_from_drive
from offpiste.rig.rig import load_rig

TIME = np.arange(0, 40, 0.02)


def drive_of(x: np.ndarray, yaw: np.ndarray = 0 * TIME, sign: np.ndarray = 1 + 0 * TIME, **axes: np.ndarray) -> Drive:
    """Return a drive along x; `sign` is that of its quaternions."""
    log = small_log(TIME, x=x, qz=sign * np.sin(yaw / 2), qw=sign * np.cos(yaw / 2), **axes)
    return drive_from_log(log, small_rig())


def after(step: float, at: int = 900) -> np.ndarray:
    return step * (np.arange(len(TIME)) >= at)


def test_a_run_is_dropped_and_named_by_its_samples_and_times() -> None:
    x = 5 * TIME
    x[1200:1286] += 3e6
    drive = drive_of(x)
    assert drive.notes == (
        "position: samples 1200 to 1285 (24.00 to 25.70 s) lie 3e+06 m off the path of any vehicle; dropped",
    )
    assert len(drive.channels["position"].time) == len(TIME) - 86
    assert len(drive.channels["orientation"].time) == len(TIME)
    (run,) = drive.faults.dropped
    assert (run.first, run.last, run.after, run.until) == (1200, 1285, TIME[1199], TIME[1286])


@pytest.mark.parametrize(
    ("end", "noted", "found"),
    [
        (1500, "(20.02 to 29.98 s) hold one place, 50 m", "10.0 s from 20.02 s on"),
        (2000, "(20.02 to 39.98 s) hold one place to the end,", "20.0 s from 20.02 s on, to the end of the log"),
    ],
)
def test_a_held_position_is_dropped_until_it_changes(end: int, noted: str, found: str) -> None:
    x = 5 * TIME
    x[1000:end] = x[1000]
    drive = drive_of(x)
    assert drive.notes == (f"position: samples 1001 to {end - 1} {noted} off the path of any vehicle; dropped",)
    (run,) = drive.faults.dropped
    assert (run.held, run.after, run.until) == (True, TIME[1000], TIME[end] if end < len(TIME) else np.inf)
    assert drive.faults.jumps == ()
    rows = extract_rows(drive)
    inside = (rows.time > 20.1) & (rows.time < TIME[end - 1] - 0.08)
    assert inside.any() == (end < len(TIME)), "rows end with the last known position"
    assert not rows.valid[inside].any()
    (finding,) = check_faults(drive)
    assert finding.what == "stays at one place while the vehicle drives on"
    assert found in finding.evidence


def test_numbers_are_those_of_the_log_where_other_samples_were_dropped() -> None:
    x = 5 * TIME
    x[100:103], x[900] = np.nan, 1e6
    notes = drive_of(x).notes
    assert notes[0].endswith("3 of 2000 samples are not finite or not valid and were dropped (samples 100 to 102)")
    assert notes[1].startswith("position: sample 900 (18.00 s) lies 1e+06 m off")


def test_many_runs_are_counted_and_headings_are_in_radians() -> None:
    yaw = 0.1 * TIME
    yaw[200:1400:200] += 0.5
    (note,) = drive_of(5 * TIME, yaw).notes
    assert note.startswith("orientation: sample 200 (4.00 s) lies 0.498 rad, sample 400")
    assert note.endswith("and 3 more runs off the path of any vehicle; dropped")


def test_quaternions_of_either_sign_are_never_interpolated_through_zero() -> None:
    yaw = 0.8 * TIME
    plain = drive_of(5 * TIME, yaw)
    yaw[700:1500:200] += 2.5  # corrupt: dropped, and no sample after one of them takes its sign
    drive = drive_of(5 * TIME, yaw, np.where(np.random.default_rng(0).random(len(TIME)) < 0.3, -1, 1))
    between = TIME[:-1] + 0.01
    values = drive.channels["orientation"].linear(between, max_gap=0.5)
    np.testing.assert_allclose(values, plain.channels["orientation"].linear(between, max_gap=0.5), atol=1e-4)
    assert len(drive.channels["orientation"].time) == len(TIME) - 4


def test_a_hopeless_pose_is_said_to_be_and_broken_at_its_jumps() -> None:
    drive = drive_of(5000 * TIME)
    assert drive.notes == ("position: moves as no vehicle does for most of the drive; nothing was dropped",)
    assert len(drive.channels["position"].time) == len(TIME)
    shaken = drive_of(1000 * (np.arange(len(TIME)) // 20 % 2))
    assert shaken.notes == drive.notes
    np.testing.assert_allclose(shaken.faults.breaks()[:2], [[TIME[19], TIME[20]], [TIME[39], TIME[40]]])


@pytest.mark.parametrize("causal", [False, True])
def test_many_jumps_mark_the_times_beside_each(causal: bool) -> None:
    drive = drive_of(1000 * (np.arange(len(TIME)) // 130 % 2))
    at, window = np.sort(np.append(TIME, TIME + 0.007)), drive.rig.motion.window
    marked, unknown = np.zeros((2, len(at)), bool)
    for before, after in drive.faults.breaks():
        marked |= (at >= after if causal else at > before - window / 2) & (at < after + window)
        unknown |= (before < at) & (at < after)
    assert 0 < unknown.sum() < marked.sum() < len(at)
    np.testing.assert_array_equal(across_jumps(drive, at, causal=causal), marked)
    poses = poses_from_drive(drive)
    known = (at >= TIME[0]) & (at <= TIME[-1])
    np.testing.assert_array_equal(np.isnan(poses.at(at)[known, 0, 0]), unknown[known])


@pytest.mark.parametrize(
    "steps",
    [{"x": -3.0}, {"x": 4.0}, {"y": 3.0}, {"z": 3.0}, {"yaw": np.deg2rad(40)}, {"y": 1.5}],
    ids=str,
)
def test_a_jump_breaks_the_drive(steps: dict[str, float]) -> None:
    shifts = {axis: after(step) for axis, step in steps.items()}
    drive = drive_of(5 * TIME + shifts.pop("x", 0), 0.5 * TIME + shifts.pop("yaw", 0), **shifts)
    assert drive.notes == ()
    np.testing.assert_allclose(drive.faults.breaks(), [[TIME[899], TIME[900]]])
    poses = poses_from_drive(drive)
    unknown = np.isnan(poses.at(np.array([17.98, 17.99, 18.0]))).all(axis=(1, 2))
    assert unknown.tolist() == [False, True, False]
    assert [poses.stretch(t) for t in (0.0, 17.98, 18.0, 39.0)] == [0, 0, 1, 1]
    rows = extract_rows(drive)
    lost = rows.time[~rows.valid & (rows.time > 1) & (rows.time < 39)]
    assert lost.min() > 17.5
    assert lost.max() < 18.5
    starts = rows.time[window_starts(rows.valid, history=10, horizon=250)]
    assert not ((starts > 12.9) & (starts < 18.3)).any()


def test_small_corrections_and_hard_braking_break_nothing() -> None:
    assert len(drive_of(5 * TIME, y=after(0.9)).faults.breaks()) == 0
    braking = np.cumsum(np.clip(15 - 9 * (TIME - 20), 0, 15)) * 0.02
    assert drive_of(braking).faults.jumps == ()


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), at=st.integers(500, 1500), far=st.floats(2.0, 40.0))
def test_of_any_smooth_drive_only_the_planted_jump_is_found(seed: int, at: int, far: float) -> None:
    rng = np.random.default_rng(seed)
    speed, yaw = 6 + 3 * np.sin(0.5 * TIME + rng.uniform(0, 6)), np.cumsum(0.02 * np.sin(0.3 * TIME))
    x, y = np.cumsum(0.02 * speed * [np.cos(yaw), np.sin(yaw)], axis=1) + rng.normal(0, 0.02, (2, len(TIME)))
    assert drive_of(x, yaw, y=y).faults.jumps == ()
    moved = drive_of(x - after(far * np.sin(yaw[at]), at), yaw, y=y + after(far * np.cos(yaw[at]), at))
    assert moved.faults.breaks().tolist() == [[TIME[at - 1], TIME[at]]]


def test_the_recorded_drives_have_none(data_folder: Path) -> None:
    drives = [(path, "tartandrive2") for path in sorted((data_folder / "tartandrive2" / "drives").glob("*"))]
    drives += [(path, "kitti") for path in sorted((data_folder / "kitti_raw" / "2011_09_26").glob("*_sync"))]
    assert drives
    for path, rig in drives:
        assert len(read_drive(path, load_rig(rig)).faults.breaks()) == 0, path.name


def test_no_row_is_complete_whose_causal_state_read_a_dropped_sample() -> None:
    x = 5 * TIME
    x[1000:1003] += 30.0
    rows = extract_rows(drive_of(x))
    lost = rows.time[~rows.valid & (rows.time > 1) & (rows.time < 39)]
    assert lost.min() <= TIME[1000]
    assert lost.max() > TIME[1002] + small_rig().motion.window
    assert lost.max() < TIME[1002] + small_rig().motion.window + 0.2
    assert np.abs(rows.state_causal[rows.valid, 3] - 5).max() < 0.01
    assert np.abs(rows.state[rows.valid, 3] - 5).max() < 0.01


@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_causal_states_do_not_depend_on_what_is_dropped_later(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, at = 5 * TIME + 0.01 * np.sin(TIME), int(rng.integers(1100, 1700))
    other = x.copy()
    other[at : at + int(rng.integers(1, 200))] += rng.uniform(20, 1e6)
    known = TIME[at] > TIME
    rows = [extract_rows(drive_of(each)) for each in (x, other)]
    early = [each.time < TIME[known][-1] for each in rows]
    for name in ("state_causal", "normal_causal"):
        one, two = (each.column(name)[mask] for each, mask in zip(rows, early, strict=True))
        np.testing.assert_array_equal(one, two)


def test_poses_are_unknown_between_the_samples_around_a_run() -> None:
    x = 5 * TIME
    x[1000:1003] += 30.0
    found = poses_from_drive(drive_of(x)).at(np.array([TIME[999], TIME[999] + 0.01, TIME[1001], TIME[1003]]))
    assert np.isnan(found).all(axis=(1, 2)).tolist() == [False, True, True, False]
