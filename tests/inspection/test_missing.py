"""Channels that the log does not have: named with what is there, and cured by a name that is nearly the same."""

from simulated import drive_log, rig

from offpiste.inspection.inspect import inspect_log

CLEAN = drive_log(seed=0)
STEER = 'topic = "steering"\nfields = ["command"]'


def test_a_field_with_another_name_is_renamed() -> None:
    found = inspect_log(CLEAN, rig((STEER, STEER.replace("command", "comand"))))
    assert found.usable is False
    finding = found.findings[0]
    assert (finding.severity, finding.where) == ("fatal", "steer")
    assert "has no field 'comand'" in finding.what
    assert finding.remedy == 'channels.steer.fields = ["command"]'


def test_a_topic_with_another_name_is_renamed() -> None:
    found = inspect_log(CLEAN, rig((STEER, STEER.replace('"steering"', '"stering"'))))
    assert found.findings[0].remedy == 'channels.steer.topic = "steering"'


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
