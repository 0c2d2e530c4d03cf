"""Steering: scale, offset, agreement with the measured angle, copies and delays."""

import numpy as np
import pytest
from simulated import MAX_STEER, START, MemoryLog, drive_log, rig

from offpiste.inspection.delays import WindowDelays, changing_delay, drifting_delay, window_delays
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log

WHEELBASE = 0.18
TRUE = np.tan(MAX_STEER) / WHEELBASE


@pytest.mark.parametrize("most", [100.0, 4.0])
def test_the_scale_of_a_first_rig_is_that_of_tyres_that_grip(most: float) -> None:
    """Fast curves slide outwards; what the vehicle turns in them says nothing on its steering."""
    (finding,) = (f for f in inspect_log(_curves(most)).findings if (f.where, f.what) == ("steer", "estimated scale"))
    assert float(finding.evidence.split()[5]) == pytest.approx(TRUE, rel=0.12)


def _curves(most: float) -> MemoryLog:
    """Curves of a small car at 0.5 to 3.5 m/s.

    Args:
        most: largest lateral acceleration, at which tyres slide [m/s^2].
    """
    random = np.random.default_rng(1)
    time = np.arange(0, 120, 0.02)
    v = 2 + 1.5 * np.sin(time / 7)
    steer = 0.8 * np.sin(time / 1.7) * np.sin(time / 11)
    yaw_rate = v * np.tan(MAX_STEER * steer) / WHEELBASE
    yaw_rate = most / v * np.tanh(yaw_rate * v / most)
    yaw = np.cumsum(yaw_rate) * 0.02
    zero = np.zeros(len(time))
    odom = {"x": np.cumsum(v * np.cos(yaw)) * 0.02, "y": np.cumsum(v * np.sin(yaw)) * 0.02, "z": zero}
    odom |= {"qx": zero, "qy": zero, "qz": np.sin(yaw / 2), "qw": np.cos(yaw / 2)}
    odom = {field: column + 1e-3 * random.standard_normal(len(time)) for field, column in odom.items()}
    throttle = np.clip(0.5 + np.gradient(v, time) + 0.1 * v, 0, 1)
    pedals = {"throttle": throttle, "brake": np.where(time % 30 > 29, 0.1, 0.0)}
    return MemoryLog(
        {"odom": (START + time, odom), "pedals": (START + time, pedals), "steering": (START + time, {"command": steer})}
    )


@pytest.mark.parametrize("topics", [["steering"], ["pedals", "steering"]])
def test_a_clock_that_is_seconds_apart_is_found_by_where_it_begins_and_ends(topics: list[str]) -> None:
    log = drive_log()
    for topic in topics:
        log = log.restamp(topic, lambda time: time + 18.0)
    cure = {edit.key: edit.value for edit in inspect_log(log, rig()).cure}
    # Of two that are alike, the pose is what is apart.
    moved = (
        ["steer", "steer_angle"] if len(topics) == 1 else [n for n, s in rig().channels.items() if s.topic == "odom"]
    )
    assert cure == {
        f"channels.{name}.delay": pytest.approx(18.0 if len(topics) == 1 else -18.0, abs=0.1) for name in moved
    }


LONG = drive_log(seconds=120)


def _delays(log: MemoryLog) -> WindowDelays:
    drive = drive_from_log(log, rig())
    return window_delays(drive.channels["steer"], driven_path(drive), rig())


def _late(by: np.ndarray | float) -> MemoryLog:
    """The log with its command `by` late [s]."""
    time, _ = LONG.data["steering"]
    return LONG.change("steering", "command", lambda values: np.interp(time - by, time, values))


@pytest.mark.parametrize("by", [0.0, 0.3, -0.4])
def test_stretches_show_the_delay(by: float) -> None:
    """The bicycle turns at once."""
    delays = _delays(_late(by))
    assert len(delays.delay) > 10
    assert np.median(delays.delay) == pytest.approx(-by, abs=0.03)
    assert drifting_delay("steer", delays) + changing_delay("steer", delays) == []


@pytest.mark.parametrize(("by", "found"), [(-0.3, {"steer_angle"}), (-0.6, {"steer", "steer_angle"}), (-0.1, set())])
def test_a_measured_angle_is_followed_at_once_and_a_command_a_little_later(by: float, found: set[str]) -> None:
    log = LONG.restamp("steering", lambda time: time + by)
    late = [f for f in inspect_log(log, rig()).findings if f.what == "comes long before the motion"]
    assert {place.split(" ")[0] for f in late for place in (f.where, *f.also)} == found


def _drifting(first: float, last: float) -> MemoryLog:
    """The log with its command late by `first` at its beginning and by `last` at its end [s]."""
    time, _ = LONG.data["steering"]
    return _late(np.interp(time, time[[0, -1]], (first, last)))


@pytest.mark.parametrize(("first", "last"), [(0.0, 0.5), (0.3, -0.2), (0.0, -1.2)])
def test_a_clock_that_drifts_is_named_with_its_change(first: float, last: float) -> None:
    (finding,) = drifting_delay("steer", _delays(_drifting(first, last)))
    assert (finding.severity, finding.what) == ("warning", "has a clock that drifts")
    said = float(finding.evidence.split("and ")[1].split(" s")[0])
    assert said == pytest.approx(first - last, rel=0.2)


def test_a_copy_that_is_late_by_turns_has_a_delay_that_changes() -> None:
    time, _ = LONG.data["steering"]
    by_turns = np.where(((time - time[0]) // 15) % 2 == 0, 0.0, 0.8)
    (finding,) = changing_delay("steer", _delays(_late(by_turns)))
    assert finding.what == "has a delay that changes"
