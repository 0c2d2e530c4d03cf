"""Channels of a drive through a rig, notes on repairs, and clocks without a common span."""

import numpy as np
import pytest

from factories import small_log, small_rig
from offpiste.core.errors import LogError
from offpiste.logs.channel import Channel
from offpiste.logs.drive import common_span, drive_from_log

TIME = 0.02 * np.arange(100)


def named(name: str, first: float, last: float) -> Channel:
    return Channel(name, "1", np.array([first, last], dtype=float), np.zeros((2, 1)))


def test_a_drive_has_the_rigs_channels_in_si_units():
    drive = drive_from_log(small_log(TIME, steer=np.full(100, 50.0)), small_rig('unit = "percent"'))
    assert set(drive.channels) == {"position", "orientation", "throttle", "brake", "steer"}
    np.testing.assert_allclose(drive.channels["steer"].values, 0.5)
    assert drive.channels["position"].unit == "m"
    assert drive.notes == ()


def test_what_was_dropped_is_noted_and_so_are_the_logs_warnings():
    log = small_log(TIME, brake=np.where(TIME == 0.06, np.nan, 0.0))
    log.warnings = ("the log is cut short",)
    cut, dropped = drive_from_log(log, small_rig()).notes
    assert cut == "the log is cut short"
    assert "brake: 1 of 100" in dropped


def test_a_topic_that_the_log_lacks_is_named():
    log = small_log(TIME)
    del log.data["steering"]
    with pytest.raises(LogError, match="no topic 'steering'"):
        drive_from_log(log, small_rig())


def test_clocks_that_do_not_meet_are_an_error_that_names_both():
    with pytest.raises(LogError, match=r"'a' ends at 5\.000 s, before 'b' begins at 1700000000\.000 s"):
        common_span([named("a", 0, 5), named("b", 1.7e9, 1.7e9 + 5)], "log")


def stepped(step: float) -> list[Channel]:
    """150 s at 10 Hz, whose clock was set forward after the first minute."""
    time = np.arange(0, 150, 0.1)
    time[600:] += step
    return [Channel(name, "1", time, np.zeros((len(time), 1))) for name in "ab"]


def test_a_clock_that_was_set_by_hours_is_an_error_that_says_where_to_cut():
    said = r"log: a gap of 20\.0 hours after 59\.900 s, in a log with 150 s of samples; .*cut the log there"
    with pytest.raises(LogError, match=said):
        common_span(stepped(72_000), "log")


def test_a_pause_is_no_clock_that_was_set():
    assert common_span(stepped(1800), "log")[1] > 1900
    drives = np.append(np.arange(0, 1200, 0.1), np.arange(15_000, 16_200, 0.1))
    both = Channel("a", "1", drives, np.zeros((len(drives), 1)))
    assert common_span([both], "log") == (0, drives[-1])
    # One channel that is silent for long says nothing: the others are recorded.
    other = Channel("b", "1", np.arange(0, 16_200, 1.0), np.zeros((16_200, 1)))
    assert common_span([named("c", 0, 16_000), other], "log") == (0, 16_000)
