"""Faults of single channels: held values, dropouts, spikes, wraps, and samples that are not finite."""

import re
from pathlib import Path

import numpy as np
import pytest
from simulated import MemoryLog, checked, drive_log, rig, severe

from offpiste.inspection import findings
from offpiste.inspection.held import check_dropouts, check_frozen
from offpiste.inspection.inspect import inspect_log

CLEAN = drive_log()


def test_every_message_is_used_and_every_used_one_exists() -> None:
    sources = "".join(file.read_text() for file in Path(findings.__file__).parent.glob("*.py"))
    assert [name for name in findings.MESSAGES if f'"{name}"' not in sources] == []
    said = re.findall(r'(?:found|fixed|_of_runs)\(\s*"(\w+)"|code = "(\w+)"|code = .* else "(\w+)"', sources)
    assert {name for names in said for name in names if name} <= findings.MESSAGES.keys()


def test_a_channel_that_hangs_is_named_with_its_time() -> None:
    time, _ = CLEAN.data["steering"]
    first = len(time) // 2
    count = int(np.searchsorted(time, time[first] + 6.0)) - first
    rows = np.arange(len(time))
    held = np.where((rows >= first) & (rows < first + count), first, rows)
    log = CLEAN.change("steering", "angle", lambda values: values[held])
    (finding,) = checked(check_frozen, log)
    assert (finding.severity, finding.where) == ("warning", "steer_angle")
    assert f"from {time[first] - time[0]:.1f}" in finding.evidence
    seconds = float(finding.evidence.split("for ")[1].split(" s")[0])
    assert seconds == pytest.approx(6.0, abs=0.2)


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
