"""Stamps with known faults."""

import re
from pathlib import Path

import numpy as np
import pytest
from simulated import RIG, MemoryLog, drive_log, rig

from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.recorded_log import RememberedLog, read_topics
from offpiste.inspection.stamps import check_headers
from offpiste.inspection.timing import timing
from offpiste.logs import open_log
from offpiste.rig.edits import Edit, edited

CLEAN = drive_log(seconds=60)


def findings(log: MemoryLog, topic: str) -> dict[str, tuple[str, str]]:
    return {f.what: (f.severity, f.evidence) for f in inspect_log(log, rig()).findings if f.where == topic}


def test_messages_that_are_sent_twice_are_no_losses() -> None:
    time, _ = CLEAN.data["pedals"]
    twice = CLEAN.keep("pedals", np.repeat(np.arange(len(time)), 2))
    twice = twice.restamp("pedals", lambda stamps: stamps + np.tile([0, 0.0005], len(time)))
    assert timing(twice.data["pedals"][0], max_gap=0.5).lost == 0
    assert "samples are missing" not in findings(twice, "pedals")


def test_dropped_samples() -> None:
    time, _ = CLEAN.data["pedals"]
    kept = np.flatnonzero(np.random.default_rng(0).random(len(time)) > 0.2)
    severity, evidence = findings(CLEAN.keep("pedals", kept), "pedals")["samples are missing"]
    assert severity == "warning"
    assert float(evidence.split("%")[0]) == pytest.approx(20, abs=2)


def test_backward_stamps() -> None:
    def back(time: np.ndarray) -> np.ndarray:
        time[1000] -= 0.5
        return time

    severity, evidence = findings(CLEAN.restamp("steering", back), "steering")["stamps go back"]
    assert severity == "warning"
    assert evidence.startswith("1 of 1500; by 0.460 s at 39.9")


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_infinite_stamps() -> None:
    def infinite(time: np.ndarray) -> np.ndarray:
        time[1000:1002], time[1010] = np.inf, -np.inf
        return time

    severity, evidence = findings(CLEAN.restamp("steering", infinite), "steering")["stamps are not finite"]
    assert severity == "warning"
    assert evidence == "3 of 1500"


def test_repeated_stamps() -> None:
    def repeat(time: np.ndarray) -> np.ndarray:
        time[1::50] = time[::50]
        return time

    severity, evidence = findings(CLEAN.restamp("steering", repeat), "steering")["stamps repeat"]
    assert severity == "note"
    assert evidence.startswith("30 of 1500 (2.0%)")


def test_stamps_that_rows_of_several_sensors_share_lose_nothing() -> None:
    """A table of an autopilot's messages: a row each, in which the columns of all others are empty."""
    stamps, odom = CLEAN.data["odom"]
    time, row = np.repeat(stamps, 2), np.arange(2 * len(stamps))
    columns = {field: np.where(row % 2, np.nan, np.repeat(values, 2)) for field, values in odom.items()}
    for own, each in (CLEAN.data["pedals"], CLEAN.data["steering"]):
        columns |= {field: np.where(row % 2, np.interp(time, own, values), np.nan) for field, values in each.items()}
    text = "[channels" + RIG.partition("[channels")[2]
    one = rig((text, re.sub('topic = "[a-z]+"', 'topic = ""', text)))

    def said(stamps: np.ndarray) -> list[str]:
        found = inspect_log(MemoryLog({"": (stamps, columns)}), one).findings
        return [finding.evidence for finding in found if finding.what == "stamps repeat"]

    assert said(time) == []
    time[2001] = time[2003]  # two samples of one sensor
    assert said(time) == [f"1 of {len(time)} (0.0%)"]


class _Received(MemoryLog):
    """A log whose messages also have stamps of their arrival: late by up to 0.6 s, in order."""

    def stamps(self, topic: str, *, stamps: str = "header") -> np.ndarray:
        time = super().stamps(topic)
        return time if stamps == "header" else time + 0.3 + 0.3 * np.sin(time) + 1e-4 * np.arange(len(time))


def test_samples_that_came_late_ask_for_no_other_clock() -> None:
    """Arrival is late by up to 0.6 s: it would spoil all stamps for the sake of three."""
    time, columns = CLEAN.data["steering"]
    order = np.arange(len(time))
    for at in (200, 700, 1100):
        order[at : at + 2] = order[[at + 1, at]]
    log = _Received({**CLEAN.data, "steering": (time[order], {name: each[order] for name, each in columns.items()})})
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.what == "stamps go back")
    assert (finding.severity, finding.cures) == ("note", ())
    assert finding.evidence.startswith("3 of 1500")


def test_a_topic_that_nothing_reads_changes_no_clock() -> None:
    class Apart(MemoryLog):
        def stamps(self, topic: str, *, stamps: str = "header") -> np.ndarray:
            late = 0.0 if stamps == "header" else 1.7 if topic == apart else 0.01
            return super().stamps(topic) + late

    time, odom = CLEAN.data["odom"]
    for apart, severity in (("spare", "note"), ("steering", "warning")):
        log = Apart({**CLEAN.data, "spare": (time, odom)})
        found = check_headers(
            read_topics(RememberedLog(log), rig())[0], rig().clock, used={"odom", "pedals", "steering"}
        )
        assert [(f.where, f.severity) for f in found] == [(apart, severity)]
        assert bool(found[0].cures) == (severity == "warning")


def test_a_clock_that_was_set_back_is_not_believed() -> None:
    class Received(MemoryLog):
        def stamps(self, topic: str, *, stamps: str = "header") -> np.ndarray:
            return super().stamps(topic) if stamps == "header" else CLEAN.data[topic][0] + 0.3

    log = Received(CLEAN.restamp("odom", lambda time: time - 5.0 * (time > np.median(time))).data)
    found = inspect_log(log, rig())
    assert [f.severity for f in found.findings if f.where == "odom" and "back" in f.what] == ["warning"]
    assert Edit("clock.stamps", "receive") in found.cure


def test_the_order_of_many_samples_is_that_of_their_stamps() -> None:
    time, columns = CLEAN.data["steering"]
    order = np.arange(len(time))
    order[::50], order[1::50] = order[1::50].copy(), order[::50].copy()
    log = _Received({**CLEAN.data, "steering": (time[order], {name: each[order] for name, each in columns.items()})})
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.what == "stamps go back")
    assert finding.severity == "warning"
    assert finding.cures[0] == (Edit("clock.sort", True),)


@pytest.mark.parametrize("copies", [True, False])
def test_samples_that_are_recorded_twice_ask_for_no_other_clock(copies: bool) -> None:
    time, columns = CLEAN.data["steering"]
    other = 0.0 if copies else 1e-3 * (np.arange(2 * len(time)) % 2)
    twice = {field: np.repeat(column, 2) + other for field, column in columns.items()}
    log = _Received({**CLEAN.data, "steering": (np.repeat(time, 2), twice)})
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.what == "stamps repeat")
    assert finding.evidence.startswith("1500 of 3000 (50.0%)")
    assert finding.severity == ("note" if copies else "warning")
    assert ("they are copies" in finding.remedy) == copies


def test_stamps_that_change_more_seldom_than_the_rows_are_one_finding() -> None:
    """A receiver's time, ten times a second, beside pedals that are recorded fifty times."""
    time, odom = CLEAN.data["odom"]
    held = (np.arange(len(time)) // 5) * 5
    columns = {"x": odom["x"][held], "y": odom["y"][held], "yaw": 2 * np.arctan2(odom["qz"], odom["qw"])[held]}
    for name, (topic, field) in {"throttle": ("pedals", "throttle"), "steer": ("steering", "command")}.items():
        columns[name] = np.interp(time, CLEAN.data[topic][0], CLEAN.data[topic][1][field])
    (finding,) = inspect_log(MemoryLog({"": (time[held], columns)})).findings
    assert (finding.severity, finding.where, finding.what) == ("fatal", "table", "stamps repeat")
    assert finding.evidence == "2400 of 3000 (80.0%): 5 samples for each, of which there are 10 a second"
    assert finding.remedy.startswith("take another clock.column; or export the stamps with all their decimals")
    copies = {name: column[held] for name, column in columns.items()}
    (finding,) = (f for f in inspect_log(MemoryLog({"": (time[held], copies)})).findings if f.what == "stamps repeat")
    assert (finding.severity, finding.remedy) == (
        "note", "nothing: they are copies of the sample before, and one of each is kept",
    )  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("stamp", ["1e-300", "1e9", "-1e308", "inf"])
def test_stamps_that_are_one_time_or_none_are_a_finding(tmp_path: Path, stamp: str) -> None:
    rows = (f"{stamp},{k / 5},{k / 9},{k / 99},{k % 7 / 9},{k % 9 / 9}\n" for k in range(300))
    (tmp_path / "a.csv").write_text("time,x,y,yaw,throttle,steer\n" + "".join(rows))
    found = {finding.what: finding for finding in inspect_log(open_log(tmp_path / "a.csv")).findings}
    if float(stamp) in (1e-300, 1e9):
        assert found["stamps repeat"].evidence == "299 of 300 (99.7%): 3e+02 samples for each"
    else:
        assert found["stamps are not finite"].evidence == "300 of 300"


def test_a_gap_of_two_minutes() -> None:
    def gap(time: np.ndarray) -> np.ndarray:
        time[1000:] += 120.0
        return time

    log = CLEAN
    for topic in ("odom", "pedals", "steering"):
        log = log.restamp(topic, lambda t: np.where(t - t[0] > 30, t + 120.0, t))
    found = inspect_log(log, rig())
    gaps = [f for f in found.findings if f.what == "has a gap"]
    assert {f.where for f in gaps} == {"odom", "pedals", "steering"}
    assert all("120.0" in f.evidence for f in gaps)
    assert found.usable
    assert not [f for f in found.findings if f.where == "position"]


def test_milliseconds_as_seconds() -> None:
    log = CLEAN
    for topic in ("odom", "pedals", "steering", "wheels"):
        log = log.restamp(topic, lambda t: (t - t[0]) * 1e3)
    found = inspect_log(log, rig())
    assert not found.usable
    assert found.findings[0].remedy == 'clock.unit = "ms"'


def test_clocks_that_do_not_overlap() -> None:
    found = inspect_log(CLEAN.restamp("steering", lambda t: t - 1000.0), rig())
    assert not found.usable
    assert found.findings[0].where == "steering"
    assert "overlap" in found.findings[0].what
    assert [edit.key for edit in found.cure] == ["channels.steer.delay", "channels.steer_angle.delay"]
    assert [edit.value for edit in found.cure] == pytest.approx([-1000.0, -1000.0], abs=0.02)
    assert inspect_log(CLEAN.restamp("steering", lambda t: t - 1000.0), edited(rig(), found.cure)).usable


def test_a_clock_of_another_time_zone_is_moved_by_whole_quarters_of_an_hour() -> None:
    found = inspect_log(CLEAN.restamp("steering", lambda t: t + 7200.0 + 0.7), rig())
    assert Edit("channels.steer.delay", 7200.0) in found.findings[0].cures[0]


def test_a_topic_that_stops_early() -> None:
    severity, evidence = findings(CLEAN.keep("pedals", np.arange(1500)), "pedals")["starts late or stops early"]
    assert severity == "warning"
    assert "30.0 s before the end" in evidence


def test_a_pose_that_stops_early_is_named_and_not_the_topics_that_go_on() -> None:
    found = inspect_log(CLEAN.keep("odom", np.arange(1500)), rig()).findings
    short = [(f.severity, f.where, f.evidence) for f in found if f.what == "starts late or stops early"]
    assert [(severity, where) for severity, where, _ in short] == [("warning", "odom")]
    assert "30.0 s before the end of the other topics" in short[0][2]


@pytest.mark.parametrize("share", [0.3, 0.5, 0.6])
def test_samples_lost_at_random_however_many(share: float) -> None:
    kept = np.flatnonzero(np.random.default_rng(0).random(3000) > share)
    severity, evidence = findings(CLEAN.keep("pedals", kept), "pedals")["samples are missing"]
    assert severity == "warning"
    assert float(evidence.split("%")[0]) == pytest.approx(100 * share, abs=3)


def test_stamps_that_are_not_finite() -> None:
    def broken(time: np.ndarray) -> np.ndarray:
        time[77] = np.nan
        return time

    assert findings(CLEAN.restamp("pedals", broken), "pedals")["stamps are not finite"][1] == "1 of 3000"


@pytest.mark.parametrize("topic", ["odom", "steering"])
def test_stamps_that_are_far_off_cost_their_own_samples_and_nothing_else_is_found(topic: str) -> None:
    def spikes(time: np.ndarray) -> np.ndarray:
        time[500] += 500
        time[1000] -= 300
        return time

    log = CLEAN.restamp(topic, spikes)
    inspection = inspect_log(log, rig())
    (finding,) = (f for f in inspection.findings if f.severity != "note")
    assert (finding.where, finding.what, finding.severity) == (topic, "stamps go back", "warning")
    count = len(CLEAN.data[topic][0])
    assert finding.evidence.startswith(f"2 of {count}; by ")
    assert finding.evidence.endswith(f"; reading drops 2 of {count} samples")
    assert inspection.summary.duration == pytest.approx(60, abs=0.1)


def test_a_clock_that_was_set_back_names_all_samples_that_it_costs() -> None:
    log = CLEAN.restamp("odom", lambda time: time - 5.0 * (time > np.median(time)))
    evidence = findings(log, "odom")["stamps go back"][1]
    assert evidence.startswith("1 of 3000; by 4.980 s")
    assert evidence.endswith("; reading drops 250 of 3000 samples")
