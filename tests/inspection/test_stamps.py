"""Stamps and clocks: order, gaps, delays, drift, units, and topics published on change."""

import re
from pathlib import Path

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, severe

from offpiste.dataset.resample import extract_rows
from offpiste.inspection.clocks import check_clocks
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.recorded_log import RememberedLog, read_topics
from offpiste.logs import open_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.channels import Clock
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig

CLEAN = drive_log(seconds=60)


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


def test_a_clock_that_was_set_back_is_not_believed() -> None:
    class Received(MemoryLog):
        def stamps(self, topic: str, *, stamps: str = "header") -> np.ndarray:
            return super().stamps(topic) if stamps == "header" else CLEAN.data[topic][0] + 0.3

    log = Received(CLEAN.restamp("odom", lambda time: time - 5.0 * (time > np.median(time))).data)
    found = inspect_log(log, rig())
    assert [f.severity for f in found.findings if f.where == "odom" and "back" in f.what] == ["warning"]
    assert Edit("clock.stamps", "receive") in found.cure


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
        "note", "no action needed: they are copies of the previous sample; one of each is kept",
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
    log = CLEAN
    for topic in ("odom", "pedals", "steering"):
        log = log.restamp(topic, lambda t: np.where(t - t[0] > 30, t + 120.0, t))
    found = inspect_log(log, rig())
    gaps = [f for f in found.findings if f.what == "has a gap"]
    assert {f.where for f in gaps} == {"odom", "pedals", "steering"}
    assert all("120.0" in f.evidence for f in gaps)
    assert found.usable
    assert not [f for f in found.findings if f.where == "position"]


def test_clocks_that_do_not_overlap() -> None:
    found = inspect_log(CLEAN.restamp("steering", lambda t: t - 1000.0), rig())
    assert not found.usable
    assert found.findings[0].where == "steering"
    assert "overlap" in found.findings[0].what
    assert [edit.key for edit in found.cure] == ["channels.steer.delay", "channels.steer_angle.delay"]
    assert [edit.value for edit in found.cure] == pytest.approx([-1000.0, -1000.0], abs=0.02)
    assert inspect_log(CLEAN.restamp("steering", lambda t: t - 1000.0), edited(rig(), found.cure)).usable


BACK = lambda time: time - 0.5 * (np.arange(len(time)) == 1000)  # noqa: E731
SET_BACK = lambda time: time - 5.0 * (time > np.median(time))  # noqa: E731


@pytest.mark.parametrize(
    ("topic", "log", "what", "evidence"),
    [
        ("steering", CLEAN.restamp("steering", BACK), "stamps go back", r"1 of 1500; by 0\.460 s at 39\.9.*"),
        (
            "odom",
            CLEAN.restamp("odom", SET_BACK),
            "stamps go back",
            r"1 of 3000; by 4\.980 s.*drops 250 of 3000 samples",
        ),
        ("pedals", CLEAN.keep("pedals", np.arange(1500)), "starts late or stops early", r".*30\.0 s before the end.*"),
    ],
    ids=["one stamp back", "clock set back", "early end"],
)
def test_faults_of_stamps_say_where_and_how_large(topic: str, log: MemoryLog, what: str, evidence: str) -> None:
    (finding,) = (f for f in inspect_log(log, rig()).findings if (f.where, f.what) == (topic, what))
    assert finding.severity == "warning"
    assert re.fullmatch(evidence, finding.evidence)


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


def findings_with_a_throttle(ahead: float, of: Rig) -> list[Finding]:
    """Findings where the throttle is a share of the speed that the vehicle has so long after it [s]."""
    time, odom = CLEAN.data["odom"]
    pedals, _ = CLEAN.data["pedals"]
    speed = np.interp(pedals + ahead, time, odom["vx"]) / odom["vx"].max()
    log = CLEAN.change("pedals", "throttle", lambda _: speed)
    recorded, _ = read_topics(RememberedLog(log), of)
    return check_clocks(recorded, driven_path(drive_from_log(log, of)), of, besides={"odom"})


@pytest.mark.parametrize("fields", [["throttle"], ["brake"]])
def test_a_speed_that_follows_a_command_is_no_clock(fields: list[str]) -> None:
    """An electric car goes as fast as its throttle says, 0.6 s later; so does a robot whose speed is commanded, whether
    a channel reads that or not."""
    assert findings_with_a_throttle(0.6, edited(rig(), [Edit("channels.throttle.fields", fields)])) == []


def test_a_speed_that_comes_late_beside_commands_is_by_a_late_clock() -> None:
    (found,) = findings_with_a_throttle(-0.6, edited(rig(), [Edit("channels.throttle.fields", ["brake"])]))
    assert found.what == "is late"
    assert found.cures == ((Edit("channels.throttle.delay", 0.6), Edit("channels.brake.delay", 0.6)),)


DRIVE = drive_log()
WHAT = "is published only when it changes"


def stepped(topic: str) -> MemoryLog:
    """A topic in steps of 0.05, as of a joystick."""
    return DRIVE.change(topic, " ".join(DRIVE.data[topic][1]), lambda values: np.round(20 * values) / 20)


def on_change(log: MemoryLog, topic: str) -> MemoryLog:
    """The log as it is where only what is new is published."""
    values = np.stack(list(log.data[topic][1].values()), axis=1)
    return log.keep(topic, np.append(True, (np.diff(values, axis=0) != 0).any(axis=1)))


@pytest.mark.parametrize(
    ("topic", "channels"), [("pedals", ("throttle", "brake")), ("steering", ("steer", "steer_angle"))]
)
def test_a_topic_on_change_is_found_and_cured(topic: str, channels: tuple[str, ...]) -> None:
    log = on_change(stepped(topic), topic)
    found = inspect_log(log, rig())
    (finding,) = (f for f in found.findings if f.severity != "note")
    assert (finding.where, finding.what) == (topic, WHAT)
    assert found.cure == tuple(Edit(f"channels.{name}.interpolation", "on change") for name in channels)
    assert not severe(log, edited(rig(), found.cure))


def test_rows_are_then_those_of_a_log_that_repeats_what_stays() -> None:
    """All rows that the steady log has, and the same controls in them."""
    steady = stepped("pedals")
    held, changing = (
        edited(rig(), [Edit(f"channels.{name}.interpolation", how) for name in ("throttle", "brake")])
        for how in ("hold", "on change")
    )
    wanted = extract_rows(drive_from_log(steady, held))
    found = extract_rows(drive_from_log(on_change(steady, "pedals"), changing))
    cut = extract_rows(drive_from_log(on_change(steady, "pedals"), held))
    np.testing.assert_array_equal(found.time, wanted.time)
    np.testing.assert_array_equal(found.control, wanted.control)
    assert found.valid.sum() == wanted.valid.sum() > 1.5 * cut.valid.sum()


@pytest.mark.parametrize("changes", [0, 5])
def test_a_gear_is_found_however_seldom_it_changes(changes: int) -> None:
    at = np.linspace(DRIVE.data["odom"][0][0] + 0.1, DRIVE.data["odom"][0][-1] - 1, changes + 1)
    log = MemoryLog({**DRIVE.data, "box": (at, {"selected": 1.0 - np.arange(len(at)) % 2})})
    geared = rig(("[channels.throttle]", '[channels.gear]\ntopic = "box"\nfields = ["selected"]\n[channels.throttle]'))
    found = inspect_log(log, geared)
    said = [f.what for f in found.findings if f.severity != "note"]
    assert said == [WHAT if changes else "channel 'gear' (topic 'box') has no usable samples"]
    assert Edit("channels.gear.interpolation", "on change") in found.cure
    assert not any(edit.key == "clock.max_gap" for edit in found.cure)
    drive = drive_from_log(log, edited(geared, [Edit("channels.gear.interpolation", "on change")]))
    assert extract_rows(drive).valid.mean() > 0.95
    box = drive.channels["gear"]
    np.testing.assert_array_equal(box.hold(at, max_gap=0.5)[:, 0], log.data["box"][1]["selected"])


@pytest.mark.parametrize(("label", "clock", "seconds"), [
    ("time [ms]", Clock(), 0.02),
    ("time [ms]", Clock(column="time [ms]", unit="s"), 20.0),
    ("time", Clock(unit="ms"), 0.02),
    ("time", Clock(), 0.02),
])  # fmt: skip
def test_a_remembered_log_has_the_unit_of_stamps_of_the_rig_or_else_of_the_header(
    tmp_path: Path, label: str, clock: Clock, seconds: float
) -> None:
    many = [f"c{number}" for number in range(70)]  # of which not all are kept
    lines = [",".join([label, *many]), *(",".join([str(20 * row), *(["0"] * 70)]) for row in range(5))]
    file = tmp_path / "drive.csv"
    file.write_text("\n".join(lines) + "\n")
    remembered = RememberedLog(open_log(file)).by(clock)
    for fields in (["c1"], ["c69"]):
        wanted = open_log(file, clock=clock).read("", fields).time
        np.testing.assert_allclose(remembered.read("", fields).time, wanted)
        assert np.diff(wanted)[0] == pytest.approx(seconds)
