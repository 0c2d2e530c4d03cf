"""Faults of single channels: held values, dropouts, spikes, wraps, and samples that are not finite."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from simulated import START, MemoryLog, checked, drive_log, rig, severe, steered

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.dropouts import check_dropouts
from offpiste.inspection.frozen import check_frozen
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.signal_faults import find_spikes, find_wrap
from offpiste.inspection.steering_fit import steering_fits
from offpiste.logs.drive import drive_from_log

CLEAN = drive_log()
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
    log = log.change("odom", "qz qw", lambda values: _held(values, first, 150))
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
        rows = np.arange(len(time))
        rests = (rows >= first) & (rows < first + count)
        log = CLEAN.change("steering", "command", lambda values, rests=rests: np.where(rests, 0.0, values))
        assert [f.where for f in checked(check_frozen, log)] == ["steer"] * found


@pytest.mark.parametrize("share", [0.3, 0.4])
def test_a_steering_that_hangs_for_a_while_is_fitted_without_that_time(share: float) -> None:
    """Else it is said to have another sign, another centre or no effect."""
    log = drive_log(seed=3)
    count = len(log.data["steering"][0])
    log = log.change("steering", "angle", lambda values: _held(values, round(0.4 * count), round(share * count)))
    found = severe(log)
    assert [(finding.where, finding.what) for finding in found] == [("steer_angle", WHAT)]
    drive = drive_from_log(log, rig())
    fit = steering_fits(drive, driven_path(drive), measured=True)["steer_angle"]
    assert fit.sign == 1
    assert abs(fit.centre) < 0.005


SLOW = CLEAN
"""The drive with a wheel that is turned slowly."""
for _field in ("command", "angle"):
    SLOW = SLOW.change("steering", _field, lambda values: 0.9 * np.sin(0.1 + np.arange(len(values)) / 40))


def _fallen(topic: str, field: str, count: int) -> MemoryLog:
    """The log with a field at zero for a while, from where it is largest on."""
    values = SLOW.data[topic][1][field].copy()
    first = int(np.abs(values).argmax()) - count // 2
    values[first : first + count] = 0.0
    return SLOW.change(topic, field, lambda _: values)


@pytest.mark.parametrize(
    ("topic", "field", "name"),
    [("steering", "command", "steer"), ("steering", "angle", "steer_angle"), ("odom", "vx", "linear_velocity")],
)
def test_a_fall_is_named_with_its_time(topic: str, field: str, name: str) -> None:
    log = _fallen(topic, field, 8)
    if field == "vx":  # all components fall at once
        held = log.data[topic][1]["vx"] == 0
        log = log.change(topic, "vy vz", lambda values: np.where(held, 0.0, values))
    (finding,) = checked(check_dropouts, log)
    time, columns = log.data[topic]
    since = time[np.flatnonzero(columns[field] == 0)[0]] - time[0]
    assert (finding.severity, finding.where) == ("warning", name)
    assert f"from {since:.2f} s on" in finding.evidence


@pytest.mark.parametrize("times", [1, 2])
def test_a_wheel_is_turned_as_far_as_it_goes_once_but_not_twice(times: int) -> None:
    def turned(values: np.ndarray) -> np.ndarray:
        for one in range(times):
            values[1000 + 500 * one :][:10] = -np.sign(values[1000 + 500 * one])
        return values

    assert len(checked(check_dropouts, SLOW.change("steering", "command", turned))) == times - 1


def test_a_wheel_that_the_vehicle_follows_was_turned() -> None:
    """A driver who steers against a rollover again and again, as the yaw rate shows; a lost value moves nothing."""
    time = np.arange(3000) / 50
    driven = 0.3 * np.sin(time / 2)
    turned = driven.copy()
    for first in (700, 1300, 2100):
        turned[first : first + 35] = -0.5
    for moved, found in ((turned, []), (driven, ["steer", "steer_angle"])):
        angle = lfilter([0.2], [1, -0.8], moved)
        yaw = np.cumsum(4 * np.tan(angle) / 2) / 50
        columns = {"x": np.cumsum(4 * np.cos(yaw)) / 50, "y": np.cumsum(4 * np.sin(yaw)) / 50, "z": 0 * yaw}
        columns |= {"qx": 0 * yaw, "qy": 0 * yaw, "qz": np.sin(yaw / 2), "qw": np.cos(yaw / 2)}
        columns |= {"vx": 0 * yaw + 4, "vy": 0 * yaw, "vz": 0 * yaw, "wx": 0 * yaw, "wy": 0 * yaw, "wz": 0 * yaw}
        steering = {"command": 2 * turned, "angle": turned}
        log = MemoryLog({**SLOW.data, "odom": (START + time, columns), "steering": (START + time, steering)})
        assert [finding.where for finding in checked(check_dropouts, log)] == found


def test_a_wheel_that_is_turned_at_once_again_and_again_is_driven_so() -> None:
    random = np.random.default_rng(0)

    def switched(values: np.ndarray) -> np.ndarray:
        return np.repeat(random.uniform(-1, 1, len(values) // 25 + 1), 25)[: len(values)]

    assert checked(check_dropouts, SLOW.change("steering", "command", switched)) == []


def test_pedals_are_let_go_in_an_instant_and_clean_logs_do_not_fall() -> None:
    assert checked(check_dropouts, _fallen("pedals", "throttle", 30)) == []
    assert checked(check_dropouts, SLOW) == []


TIME = np.arange(0, 60, 0.02)
SMOOTH = 150 + 100 * np.sin(TIME) + np.random.default_rng(0).standard_normal(len(TIME))


def test_spikes_are_found_where_they_are() -> None:
    values = SMOOTH.copy()
    at = [100, 900, 901, 2500]
    values[at] = 5000, -4000, -3500, 900
    assert np.flatnonzero(find_spikes(values)).tolist() == at


@pytest.mark.parametrize(
    "values",
    [
        SMOOTH,
        np.where(np.sin(5 * TIME) > 0.9, 1.0, 0.0),
        np.random.default_rng(2).standard_normal(3000) ** 3,
        np.round(SMOOTH / 20),
        np.clip(np.sin(20 * TIME), 0.9, 1),
    ],
    ids=["smooth", "switch", "rough ground", "quantised", "bumps"],
)
def test_what_is_no_spike(values: np.ndarray) -> None:
    assert not find_spikes(values).any()


@pytest.mark.parametrize(("period", "scale"), [(65536.0, 100.0), (6553.6, 10.0), (655.36, 1.0)])
def test_wraps_of_sixteen_bits_in_runs(period: float, scale: float) -> None:
    counts = np.round((SMOOTH - 80) * scale) / 10
    wrap = find_wrap(np.where(counts < 0, counts + period, counts))
    assert wrap is not None
    assert wrap.period == period
    assert counts.max() < wrap.above < counts.min() + period


@pytest.mark.parametrize(
    "values",
    [
        np.where(np.random.default_rng(3).random(3000) < 0.02, 0.0, 6550.0 + SMOOTH / 100),
        SMOOTH,
        np.linspace(0, 65535, 3000),
        np.where(np.sin(TIME) > 0, 6500.0, 0.0),
        np.abs(SMOOTH) * 40,
        np.random.default_rng(1).uniform(0, 6553, 3000),
    ],
    ids=["dropouts", "smooth", "counter", "switch", "engine", "noise"],
)
def test_what_is_no_wrap(values: np.ndarray) -> None:
    assert find_wrap(values) is None


def test_nan_and_infinity_are_counted() -> None:
    def broken(x: np.ndarray) -> np.ndarray:
        x[10:20], x[30] = np.nan, np.inf
        return x

    log = drive_log(seconds=60).change("pedals", "throttle", broken)
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.severity == "warning")
    assert finding.where.startswith("throttle")
    assert finding.evidence == "11 of 3000 samples (0.4%), the first 10, the last 30"


def test_rows_that_a_slower_sensor_leaves_empty_are_no_fault() -> None:
    row = np.arange(3000)
    log = drive_log(seconds=60).change("pedals", "throttle", lambda x: np.where(row % 3 > 0, np.nan, x))
    assert not severe(log)
    lost = log.change("pedals", "throttle", lambda x: np.where((row >= 1000) & (row < 1100), np.nan, x))
    (finding,) = (f for f in inspect_log(lost, rig()).findings if f.what.startswith("values are NaN"))
    assert (finding.severity, finding.where.split(" ")[0]) == ("warning", "throttle")
    assert "the first 1000, the last 1100" in finding.evidence


@pytest.mark.parametrize("per_second", [1, 1e3, 1e9])
def test_times_since_1970_are_no_measurement(per_second: float) -> None:
    log = drive_log()
    time, columns = log.data["pedals"]
    stamps = np.floor(1.7e9 + time) * per_second
    stamps[:5] = 0
    mixed = np.random.default_rng(0).permutation(stamps)
    log = MemoryLog({**log.data, "pedals": (time, {**columns, "stamp.sec": stamps, "other": mixed})})
    beyond = [finding.where for finding in inspect_log(log).findings if "beyond any measurement" in finding.what]
    assert beyond == ["pedals other"]


@pytest.mark.parametrize("rest", [0.0, 0.1, -0.02, 1.0])
def test_a_brake_that_nobody_pressed_is_kept(rest: float) -> None:
    log = drive_log(seconds=60, braking=0.0).change("pedals", "brake", lambda values: np.full(len(values), rest))
    found = inspect_log(log, rig())
    assert found.cure == ()
    assert [f for f in found.findings if f.severity != "note"] == []
    (note,) = (f for f in found.findings if f.where.startswith("brake"))
    assert ("channels.brake.scale = -1.0, channels.brake.offset = 1.0" in note.remedy) == (rest == 1.0)


@pytest.mark.parametrize("lost", [np.nan, 0.0])
def test_a_motion_capture_that_loses_the_vehicle_once_has_one_warning(lost: float) -> None:
    """Its pose and the velocities that it estimates are not numbers, or zero, for 75 samples."""
    log = drive_log()
    for field in log.data["odom"][1]:
        log = log.change("odom", field, lambda x: np.where(np.abs(np.arange(len(x)) - 2537) < 38, lost, x))
    (finding,) = severe(log)
    assert "2500" in finding.evidence
    if np.isnan(lost):
        assert finding.where == "position, orientation, linear_velocity, angular_velocity"
        assert "75 of 4500 samples" in finding.evidence
        assert "odom x" in finding.evidence
