"""Delays of the turning by stretches: clocks that drift, copies that are late by turns, constant delays."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, steered

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.steering_delays import WindowDelays, changing_delay, uneven_delay, window_delays
from offpiste.logs.drive import drive_from_log

CLEAN = drive_log(seed=0, seconds=120.0)


def _delays(log: MemoryLog) -> WindowDelays:
    drive = drive_from_log(log, rig())
    return window_delays(drive.channels["steer"], driven_path(drive), rig())


def _late(by: np.ndarray | float) -> MemoryLog:
    """The log with its command `by` late [s]."""
    time, _ = CLEAN.data["steering"]
    return CLEAN.change("steering", "command", lambda values: np.interp(time - by, time, values))


@pytest.mark.parametrize("by", [0.0, 0.3, -0.4])
def test_stretches_show_the_delay(by: float) -> None:
    """The bicycle turns at once."""
    delays = _delays(_late(by))
    assert len(delays.delay) > 10
    assert np.median(delays.delay) == pytest.approx(-by, abs=0.03)
    assert changing_delay("steer", delays) == []
    assert uneven_delay("steer", delays) == []


def _measured(column: str) -> str:
    return f'[channels.steer]\ntopic = "steering"\nfields = ["{column}"]\n'


def test_one_column_that_is_read_as_steering_and_as_angle_gets_one_delay() -> None:
    """A measured angle is followed sooner than a command: both are cured as of the angle."""
    both = rig((_measured("command"), _measured("angle") + 'unit = "rad"\n'))
    late = CLEAN.restamp("steering", lambda time: time + 0.3)
    found = [finding for finding in inspect_log(late, both).findings if "delay" in finding.remedy]
    (cure,) = (finding.cures[0] for finding in found)
    assert {edit.key: edit.value for edit in cure} == dict.fromkeys(
        ("channels.steer_angle.delay", "channels.steer.delay"), pytest.approx(0.35, abs=0.02)
    )


@pytest.mark.parametrize(
    ("column", "usual"), [("command", 0.1), ("handlebar", 0.0), ("handlebar_cmd", 0.1), ("Steered Angle", 0.0)]
)
def test_a_steering_that_is_measured_by_its_name_is_followed_sooner_than_a_command(column: str, usual: float) -> None:
    time, columns = CLEAN.data["steering"]
    log = MemoryLog({**CLEAN.data, "steering": (time + 0.3, {column: columns["command"]})})
    alone = rig(
        (_measured("command"), _measured(column)),
        ('[channels.steer_angle]\ntopic = "steering"\nfields = ["angle"]\n', ""),
        ('"brake_pressure",', '"brake_pressure", "steer_angle",'),
    )
    (edit,) = (edit for edit in inspect_log(log, alone).cure if edit.key == "channels.steer.delay")
    assert edit.value == pytest.approx(0.35 + usual, abs=0.02)


def _drifting(first: float, last: float) -> MemoryLog:
    """The log with its command late by `first` at its beginning and by `last` at its end [s]."""
    time, _ = CLEAN.data["steering"]
    return _late(np.interp(time, time[[0, -1]], (first, last)))


@pytest.mark.parametrize(("first", "last"), [(0.0, 0.5), (0.3, -0.2), (0.0, -1.2)])
def test_a_clock_that_drifts_is_named_with_its_change(first: float, last: float) -> None:
    (finding,) = changing_delay("steer", _delays(_drifting(first, last)))
    assert (finding.severity, finding.what) == ("warning", "has a clock that drifts")
    said = float(finding.evidence.split("and ")[1].split(" s")[0])
    assert said == pytest.approx(first - last, rel=0.2)


def test_a_steering_that_is_moved_slowly_shows_no_delay() -> None:
    """It fits at any: where the best one lies is chance."""
    time, _ = CLEAN.data["steering"]
    slow = steered(CLEAN, 0.4 * np.sin((time - time[0]) / 5), follows=0.0)
    assert len(_delays(slow).delay) < 3
    assert not any("delay" in f.what for f in inspect_log(slow, rig()).findings)
    quick = steered(CLEAN, 0.4 * np.sin(2 * (time - time[0])), follows=0.0)
    assert len(_delays(quick).delay) > 10


def test_a_vehicle_that_only_turns_later_and_later_may_be_slow_itself() -> None:
    (finding,) = changing_delay("steer", _delays(_drifting(-0.1, -0.6)))
    assert (finding.severity, finding.what) == ("note", "has a clock that drifts")


def test_a_copy_that_is_late_by_turns_has_a_delay_that_changes() -> None:
    time, _ = CLEAN.data["steering"]
    by_turns = np.where(((time - time[0]) // 15) % 2 == 0, 0.0, 0.8)
    (finding,) = changing_delay("steer", _delays(_late(by_turns)))
    assert finding.what == "has a delay that changes"


def test_few_early_stretches_do_not_count() -> None:
    time = np.arange(20.0)
    mostly_usual = WindowDelays(time, np.array([0.3, 0.25, -0.2] + [0.28, 0.22] * 8 + [-0.15]))
    assert changing_delay("steer", mostly_usual) == []
    assert uneven_delay("steer", mostly_usual) == []


def test_one_event_that_two_stretches_share_does_not_count() -> None:
    usual = [0.09, 0.1, 0.1, 0.11, 0.13, 0.14, 0.15]
    assert uneven_delay("steer", WindowDelays(np.arange(9.0), np.array([-1.29, -1.2, *usual]))) == []
    assert len(uneven_delay("steer", WindowDelays(np.arange(10.0), np.array([-1.29, -1.2, -1.3, *usual])))) == 1


def test_a_slight_change_counts_where_most_are_early() -> None:
    delays = WindowDelays(np.arange(10.0), np.array([0.05, -0.2, 0.0, -0.25, 0.1, -0.2, 0.0, -0.1, 0.1, -0.2]))
    (finding,) = uneven_delay("steer", delays)
    assert "10 stretches" in finding.evidence
