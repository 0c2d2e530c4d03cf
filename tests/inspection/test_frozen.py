"""Channels that hold one value: found while the vehicle moves, and where they usually change."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import drive_log, rig, steered

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.frozen import check_frozen
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.steering_fit import steering_fits
from offpiste.logs.drive import drive_from_log

CLEAN = drive_log(seed=0)
WHAT = "holds one value while the vehicle moves"


def _held(values: np.ndarray, first: int, count: int) -> np.ndarray:
    values = values.copy()
    values[first : first + count] = values[first]
    return values


def _frozen(log) -> list:
    return [f for f in inspect_log(log, rig()).findings if f.what == WHAT]


def test_a_channel_that_hangs_is_named_with_its_time() -> None:
    time, _ = CLEAN.data["steering"]
    first = len(time) // 2
    count = int(np.searchsorted(time, time[first] + 6.0)) - first
    log = CLEAN.change("steering", "angle", lambda values: _held(values, first, count))
    (finding,) = _frozen(log)
    assert (finding.severity, finding.where) == ("warning", "steer_angle")
    assert f"from {time[first] - time[0]:.1f}" in finding.evidence
    seconds = float(finding.evidence.split("for ")[1].split(" s")[0])
    assert seconds == pytest.approx(6.0, abs=0.2)


@pytest.mark.parametrize(("value", "found"), [(0.0, 0), (1.0, 0), (0.5, 1)])
def test_pedals_may_rest_at_an_end_of_their_range_and_nowhere_else(value: float, found: int) -> None:
    time, _ = CLEAN.data["pedals"]

    def pressed(values: np.ndarray) -> np.ndarray:
        values = np.random.default_rng(0).uniform(0.2, 0.7, len(values))
        values[(time > time[len(time) // 2]) & (time < time[len(time) // 2] + 6.0)] = value
        return values

    assert len(_frozen(CLEAN.change("pedals", "throttle", pressed))) == found


def test_controls_in_steps_hold_by_nature() -> None:
    assert _frozen(CLEAN.change("steering", "command", lambda values: np.round(2 * values) / 2)) == []


def test_a_clean_log_holds_nothing() -> None:
    assert _frozen(CLEAN) == []


def test_who_stops_with_the_wheel_turned_and_starts_again_holds_nothing() -> None:
    time, _ = CLEAN.data["steering"]
    begin, end = len(time) // 2, int(np.searchsorted(time, time[len(time) // 2] + 8.0))
    log = CLEAN.change("steering", "angle", lambda values: _held(values, begin, end - begin))
    drive = drive_from_log(log, rig())
    path = driven_path(drive)
    assert [finding.where for finding in check_frozen(drive, path)] == ["steer_angle"]
    stands = (path.time > time[begin] + 1.0) & (path.time < time[end] - 1.0)
    assert check_frozen(drive, replace(path, speed=np.where(stands, 0.0, path.speed))) == []


@pytest.mark.parametrize("seconds", [1.0, 4.0])
def test_a_heading_that_stays_the_same_on_a_straight_is_not_held(seconds: float) -> None:
    """As a simulator logs it: the course stays the same, too."""
    time, steering = CLEAN.data["steering"]
    elapsed = time - time[0]
    straight = np.any([(elapsed > begin) & (elapsed < begin + seconds) for begin in (12.0, 45.0)], axis=0)
    log = steered(CLEAN, np.where(straight, 0.0, steering["command"]), follows=0.0)
    assert _frozen(log) == []
    first = int(np.searchsorted(log.data["odom"][0], time[0] + 20.0))
    for field in ("qz", "qw"):
        log = log.change("odom", field, lambda values: _held(values, first, 150))
    assert [finding.where for finding in _frozen(log)] == ["orientation"]


@pytest.mark.parametrize("seconds", [0.6, 3.0])
def test_headings_that_hang_again_and_again_are_found(seconds: float) -> None:
    log, count = CLEAN, int(seconds / 0.02)
    for field in ("qx", "qy", "qz", "qw"):
        for first in (800, 1700, 2600, 3500):
            log = log.change("odom", field, lambda values: _held(values, first, count))  # noqa: B023
    (finding,) = (f for f in _frozen(log) if f.where == "orientation")
    assert " times, " in finding.evidence
    assert f"the longest for {seconds:.1f} s" in finding.evidence


def test_a_steering_that_rests_at_zero_while_the_vehicle_turns_hangs() -> None:
    _, odom = CLEAN.data["odom"]
    time, _ = CLEAN.data["steering"]
    turning = np.abs(np.interp(time, CLEAN.data["odom"][0], odom["wz"]))
    count = round(8.0 / float(np.median(np.diff(time))))
    sums = np.convolve(turning**2, np.ones(count), "valid")
    for first, found in ((int(sums.argmax()), 1), (int(sums.argmin()), 0)):

        def rested(values: np.ndarray, first: int = first) -> np.ndarray:
            return np.concatenate((values[:first], np.zeros(count), values[first + count :]))

        log = CLEAN.change("steering", "command", rested)
        drive = drive_from_log(log, rig())
        assert [f.where for f in check_frozen(drive, driven_path(drive))] == ["steer"] * found


def test_a_steering_that_is_held_while_the_vehicle_drives_straight_may_be_the_drivers() -> None:
    time, _ = CLEAN.data["steering"]
    count = round(6.0 / float(np.median(np.diff(time))))
    first = len(time) // 2
    log = CLEAN.change("steering", "command", lambda values: _held(values, first, count))
    drive = drive_from_log(log, rig())
    path = driven_path(drive)
    assert [finding.where for finding in check_frozen(drive, path)] == ["steer"]
    inside = (path.time > time[first]) & (path.time < time[first + count])
    straight = replace(path, yaw_rate=np.where(inside, 0.1, path.yaw_rate))
    assert check_frozen(drive, straight) == []


def test_a_steering_that_hangs_from_one_standstill_to_the_next_is_found() -> None:
    time, _ = CLEAN.data["odom"]
    path = driven_path(drive_from_log(CLEAN, rig()))
    begin, end = time[len(time) // 3], time[2 * len(time) // 3]
    near = np.minimum(np.abs(path.time - begin), np.abs(path.time - end)) < 0.5
    steered_, _ = CLEAN.data["steering"]
    first, last = np.searchsorted(steered_, (begin, end))
    log = CLEAN.change("steering", "angle", lambda values: _held(values, first, last - first))
    stopping = replace(path, speed=np.where(near, 0.0, path.speed), forward=np.where(near, 0.0, path.forward))
    assert [finding.where for finding in check_frozen(drive_from_log(log, rig()), stopping)] == ["steer_angle"]


def test_a_lock_that_is_held_from_the_other_one_on_does_not_hang() -> None:
    """The vehicle turns the old way until the wheels have followed; then evenly, as the driver holds it."""
    time, columns = CLEAN.data["steering"]
    now = time - time[len(time) // 2]
    swung = np.where((now > -2.5) & (now <= 0), -1.0, np.where((now > 0) & (now < 6.5), 1.0, columns["command"]))
    drive = drive_from_log(steered(CLEAN, swung, follows=0.3), rig())
    path = driven_path(drive)
    turned = np.std(path.yaw_rate[np.abs(path.time - time[len(time) // 2] - 3.25) < 3.25])
    assert turned > 0.7 * np.sqrt(np.mean(path.yaw_rate**2))  # at first sight it turns to and fro
    assert [finding.where for finding in check_frozen(drive, path)] == []


@pytest.mark.parametrize("share", [0.3, 0.4])
def test_a_steering_that_hangs_for_a_while_is_fitted_without_that_time(share: float) -> None:
    """Else it is said to have another sign, another centre or no effect."""
    log = drive_log(seed=3)
    count = len(log.data["steering"][0])
    log = log.change("steering", "angle", lambda values: _held(values, round(0.4 * count), round(share * count)))
    found = [finding for finding in inspect_log(log, rig()).findings if finding.severity != "note"]
    assert [(finding.where, finding.what) for finding in found] == [("steer_angle", WHAT)]
    drive = drive_from_log(log, rig())
    fit = steering_fits(drive, driven_path(drive), measured=True)["steer_angle"]
    assert fit.sign == 1
    assert abs(fit.centre) < 0.005
