"""A drifting clock: planted lags are found again, and no order is ever turned round."""

import numpy as np
import pytest

from factories import MemoryLog, small_rig
from offpiste.logs.channel import Channel
from offpiste.logs.clock_drift import ClockLag, align_clock, estimate_lag, pose_speed
from offpiste.logs.drive import drive_from_log

TIME = np.arange(0, 80, 0.05)
SPEED = 4 + 2 * np.sin(0.9 * TIME) + 1.2 * np.sin(2.3 * TIME + 1) + 0.5 * np.sin(5.1 * TIME)

ALIGNMENT = """
[alignment]
topics = ["pedals"]
speed = { topic = "wheels", fields = ["left", "right"] }
"""


def late(lag: np.ndarray) -> Channel:
    """The speed as stamped by a clock that is late."""
    return Channel("wheel_speed", "m/s", TIME + lag, SPEED[:, None])


def reference() -> Channel:
    return Channel("speed", "m/s", TIME, SPEED[:, None])


@pytest.mark.parametrize("lag", [0.0, 0.6, -0.3])
def test_a_constant_lag_is_found(lag):
    found = estimate_lag(reference(), late(np.full_like(TIME, lag)), max_lag=2.0)
    inner = (found.time > 2) & (found.time < 78)
    np.testing.assert_allclose(found.lag[inner], lag, atol=0.051)
    assert np.abs(found.lag[inner] - lag).mean() < 0.03


def test_a_lag_that_drifts_and_jumps_is_followed():
    lag = 0.3 + 0.2 * np.sin(0.1 * TIME) + 0.6 * (TIME > 40)
    found = estimate_lag(reference(), late(lag), max_lag=2.0)
    away = (found.time > 2) & (found.time < 78) & (np.abs(found.time - 40) > 1)
    error = found.lag - np.interp(found.time, TIME, lag)
    assert np.abs(error[away]).max() < 0.15
    assert np.abs(error[away]).mean() < 0.04


def test_noise_does_not_make_the_lag_wander():
    noisy = late(np.zeros_like(TIME))
    noisy = Channel("", "", noisy.time, noisy.values + np.random.default_rng(0).normal(0, 0.3, noisy.values.shape))
    found = estimate_lag(reference(), noisy, max_lag=2.0)
    assert np.ptp(found.lag[(found.time > 2) & (found.time < 78)]) < 0.3


def test_later_samples_never_happen_earlier():
    rng = np.random.default_rng(0)
    other = Channel("", "", TIME, rng.normal(3, 2, (len(TIME), 1)))  # nothing in common with the reference
    found = estimate_lag(reference(), other, max_lag=2.0, stiffness=0.01)
    assert (np.diff(found.time + found.lag) > 0).all()
    stamps = np.arange(-5, 90, 0.01)
    assert (np.diff(found.happened(stamps)) > 0).all()


def test_stamps_become_the_times_they_happened_also_beyond_the_ends():
    clock = ClockLag(np.array([0.0, 1.0, 2.0]), np.array([0.5, 0.5, 1.0]))
    np.testing.assert_allclose(clock.happened(np.array([-1.0, 0.5, 1.0, 2.25, 3.0, 4.0])), [-1.5, 0, 0.5, 1.5, 2, 3])


def test_speed_by_the_pose_is_the_length_of_the_velocity_or_its_derivative():
    velocity = Channel("", "m/s", TIME, np.stack((3 + 0 * TIME, 4 + 0 * TIME, 0 * TIME), axis=1))
    place = Channel("", "m", TIME, np.stack((3 * TIME, 4 * TIME, TIME), axis=1))
    for channels in ({"linear_velocity": velocity, "position": place}, {"position": place}):
        np.testing.assert_allclose(pose_speed(channels).values, 5.0)


def test_only_the_topics_of_the_drifting_clock_are_moved():
    along = np.cumsum(SPEED) * 0.05
    zero, ones, lag = 0 * TIME, np.ones(len(TIME)), 0.5
    place = {"x": along, "y": zero, "z": zero, "qx": zero, "qy": zero, "qz": zero, "qw": ones}
    log = MemoryLog(
        odometry=(TIME, place),
        pedals=(TIME + lag, {"throttle": zero, "brake": zero}),
        steering=(TIME, {"steer": zero}),
        wheels=(TIME + lag, {"left": SPEED - 0.1, "right": SPEED + 0.1}),
    )
    drive = drive_from_log(log, small_rig(ALIGNMENT))
    np.testing.assert_array_equal(drive.channels["steer"].time, TIME)
    assert np.abs(drive.channels["throttle"].time - TIME)[40:-40].max() < 0.06
    assert "clock of pedals: 0.50 s late" in drive.notes[-1]
    rig = small_rig(ALIGNMENT)
    assert rig.alignment is not None
    channels, _ = align_clock(log, rig, rig.alignment, dict(drive.channels))
    assert set(channels) == set(drive.channels)
