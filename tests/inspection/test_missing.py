"""Channels that the log does not have, cured by a name that is nearly the same; controls that nothing reads."""

from pathlib import Path

import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.core.errors import LogError
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.logs import open_log

CLEAN = drive_log()
STEER = 'topic = "steering"\nfields = ["command"]'


def test_a_field_with_another_name_is_renamed() -> None:
    found = inspect_log(CLEAN, rig((STEER, STEER.replace("command", "comand"))))
    assert found.usable is False
    finding = found.findings[0]
    assert (finding.severity, finding.where) == ("fatal", "steer")
    assert "has no field 'comand'" in finding.what
    assert finding.remedy == 'channels.steer.fields = ["command"]'


def test_a_channel_that_nothing_resembles_is_declared_absent() -> None:
    change = ("[channels.brake]\n", '[channels.wheel_speed]\ntopic = "encoders"\nfields = ["a"]\n[channels.brake]\n')
    finding = inspect_log(CLEAN, rig(change)).findings[0]
    assert finding.where == "wheel_speed"
    assert "is not in the log" in finding.what
    assert "remove channels.wheel_speed" in finding.remedy


def test_a_pose_is_never_declared_absent() -> None:
    finding = inspect_log(CLEAN, rig(('topic = "odom"\nfields = ["x"', 'topic = "gps"\nfields = ["x"'))).findings[0]
    assert finding.where == "position"
    assert finding.cures == ()
    assert "[channels.position]" in finding.remedy


def test_pedals_that_read_the_same_are_named() -> None:
    def said(more: str) -> list[tuple[str, str, str]]:
        both = rig(('fields = ["brake"]\n', f'fields = ["throttle"]\n{more}'))
        found = [finding for finding in inspect_log(CLEAN, both).findings if finding.what == "read the same"]
        return [(finding.severity, finding.where, finding.evidence) for finding in found]

    evidence = "both read throttle of topic 'pedals', with the same sign"
    assert said("") == said("clip = [0.0, 1.0]\n") == [("warning", "throttle, brake", evidence)]
    assert said("sign = -1\nclip = [0.0, 1.0]\n") == said("scale = -1.0\noffset = 1.0\n") == []


def test_a_log_of_another_vehicle_is_said_in_one_finding() -> None:
    log = MemoryLog({f"/{number}/{topic.upper()}": data for number, (topic, data) in enumerate(CLEAN.data.items())})
    (finding,) = inspect_log(log, rig()).findings
    assert (finding.severity, finding.where) == ("fatal", "log")
    assert "none of the topics" in finding.what
    assert "/0/ODOM" in finding.evidence


def test_a_log_without_samples_is_said_in_one_finding() -> None:
    log = MemoryLog(
        {topic: (time[:0], {f: v[:0] for f, v in fields.items()}) for topic, (time, fields) in CLEAN.data.items()}
    )
    (finding,) = inspect_log(log, rig()).findings
    assert (finding.severity, finding.where, finding.what) == ("fatal", "log", "holds no numbers")


PEDALS = "".join(f'[channels.{name}]\ntopic = "pedals"\nfields = ["{name}"]\n' for name in ("throttle", "brake"))
NO_PEDALS = (('absent = ["brake_pressure"', 'absent = ["throttle", "brake", "brake_pressure"'), (PEDALS, ""))


def notes(log, *changes):
    return [f for f in inspect_log(log, rig(*changes)).findings if f.what.endswith("not read")]


def test_pedals_that_nothing_reads_are_named():
    (finding,) = notes(CLEAN, *NO_PEDALS)
    assert (finding.severity, finding.where) == ("note", "throttle, brake")
    assert "pedals" in finding.evidence
    assert "throttle, brake" in finding.evidence
    assert "[channels.throttle]" in finding.remedy


def test_a_place_that_is_text_is_named_beside_the_columns_of_numbers(tmp_path: Path) -> None:
    """Degrees and minutes as VBOX Test Suite writes them."""
    path = tmp_path / "vbox.csv"
    rows = "".join(f"{0.05 * k:.2f},47°24.{k:04d} N,008°30.0000 E,{k}\n" for k in range(50))
    path.write_text(f"Time,Latitude,Longitude,Heading\n{rows}", "utf-8")
    with pytest.raises(LogError, match=r"column 'Latitude' holds text, such as '47°24.0000 N', and no numbers"):
        draft_rig(open_log(path))
