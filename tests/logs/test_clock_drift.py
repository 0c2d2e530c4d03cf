"""Estimates of known lags, offsets and drifts of clocks."""

import numpy as np
import pytest

from factories import small_log, small_rig
from offpiste.core.errors import LogError
from offpiste.logs.channel import Channel
from offpiste.logs.clock_drift import ClockLag, clock_difference, estimate_lag, pose_speed
from offpiste.logs.drive import drive_from_log
from sensor_bags import IMAGE, cloud, compressed, info, opened, record, tree

TIME = np.arange(0, 80, 0.05)
SPEED = 4 + 2 * np.sin(0.9 * TIME) + 1.2 * np.sin(2.3 * TIME + 1) + 0.5 * np.sin(5.1 * TIME)

ALIGNMENT = """
[alignment]
topics = ["pedals"]
speed = { topic = "wheels", fields = ["left", "right"] }
"""


def late(lag: np.ndarray) -> Channel:
    """Return the speed stamped by a late clock."""
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
    slow = [Channel("", "m", TIME[::every], place.values[::every]) for every in (4, 10)]
    for channels in ({"linear_velocity": velocity, "position": place}, *({"position": one} for one in (place, *slow))):
        np.testing.assert_allclose(pose_speed(channels).values, 5.0)


def test_only_the_topics_of_the_drifting_clock_are_moved():
    log, lag = small_log(TIME, x=np.cumsum(SPEED) * 0.05), 0.5
    log.data["pedals"] = (TIME + lag, log.data["pedals"][1])
    log.data["wheels"] = (TIME + lag, {"left": SPEED - 0.1, "right": SPEED + 0.1})
    drive = drive_from_log(log, small_rig(ALIGNMENT))
    np.testing.assert_array_equal(drive.channels["steer"].time, TIME)
    assert np.abs(drive.channels["throttle"].time - TIME)[40:-40].max() < 0.06
    assert "clock of pedals: 0.50 s late" in drive.notes[-1]


STILL = [(0, "/tf_static", tree()), (0, "/info", info())]


@pytest.mark.parametrize("drift", [-0.3, 0.0, 0.08])
@pytest.mark.parametrize("offset", [-2.0, 0.05])
def test_offset_and_drift_come_back(offset, drift):
    rng = np.random.default_rng(0)
    pose, image = np.arange(0, 60, 0.02), np.arange(0, 60, 0.5)
    pose_arrivals = pose + rng.exponential(0.005, len(pose))
    arrivals = image + 0.01 + rng.exponential(0.03, len(image))  # a camera sends late, and sometimes very late
    stamps = image - offset - drift * (image - 30) / 60
    found = clock_difference(stamps, arrivals, pose, pose_arrivals)
    assert found is not None
    assert found.offset == pytest.approx(offset + 0.01, abs=0.01)
    assert found.drift == pytest.approx(drift, abs=0.02)


def test_a_clock_that_all_share_is_no_drift():
    """The whole vehicle's clock against the recorder's."""
    pose, image = np.arange(0, 60, 0.02), np.arange(0, 60, 0.5)
    assert clock_difference(1.01 * image, image, 1.01 * pose, pose) == pytest.approx((0.0, 0.0), abs=0.006)


def test_too_little_says_nothing():
    none = np.zeros(0)
    assert clock_difference(none, none, none, none) is None
    assert clock_difference(np.ones(1), np.ones(1), np.ones(5), np.arange(5.0)) is None


def with_drift(path, drift: float, offset: float = 0.0):
    """Open ten seconds with a camera whose clock runs ahead, and ever further."""
    arrive = np.arange(0, 10.05, 0.25).tolist()
    messages = [(t, "/image", compressed(t * (1 + drift / 10) + offset, IMAGE)) for t in arrive]
    messages += [(t, "/points", cloud(t)) for t in arrive]
    return opened(record(path, [*STILL, *messages], until=10.0))


def test_a_camera_that_drifts_is_told_and_then_refused(tmp_path):
    assert with_drift(tmp_path / "none.mcap", 0.0).coverage() == ()
    assert with_drift(tmp_path / "near.mcap", 0.0, 0.1).coverage() == ()
    notes = with_drift(tmp_path / "off.mcap", 0.0, 3.0).coverage()
    assert "front: stamped 3.00 s after poses that arrive with it; fix its clock or its delay" in notes
    (said,) = with_drift(tmp_path / "some.mcap", 0.1).coverage()
    assert said == "front: stamps drift against the pose clock by 101 ms over the drive"
    wrong = r"x\.mcap: 'front': stamps drift against the pose clock by 0\.5. s over the drive; use clock\.stamps"
    with pytest.raises(LogError, match=wrong):
        with_drift(tmp_path / "x.mcap", 0.5).coverage()
