"""Poses that are late, against sensors that are early: which of them is stamped wrong."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.inspect import inspect_log
from offpiste.rig.edits import Edit, edited

FIELDS = {
    "orientation": ("qx", "qy", "qz", "qw"),
    "angular_velocity": ("wx", "wy", "wz"),
    "position": ("x", "y", "z", "qx", "qy", "qz", "qw"),
    "linear_velocity": ("vx", "vy", "vz"),
}


def _late(channel: str, by: float) -> MemoryLog:
    """The drive of a vehicle that turns 0.15 s after its steering, with some columns stamped late."""
    log = drive_log()
    time, command = log.data["steering"]
    log = MemoryLog({**log.data, "steering": (time - 0.15, command)})
    time = log.data["odom"][0]
    for field in FIELDS[channel]:
        log = log.change("odom", field, lambda values: np.interp(time - by, time, values))
    return log


@pytest.mark.parametrize("channel", FIELDS)
@pytest.mark.parametrize("by", [-0.2, 0.4])
def test_what_is_late_is_what_most_else_differs_from(channel: str, by: float) -> None:
    first = inspect_log(_late(channel, by), rig()).findings[0]
    assert (first.where, first.what) == (channel, "is late" if by > 0 else "is early")
    cured = {edit.key: edit.value for edit in first.cures[0]}
    together = ("position", "orientation") if channel == "position" else (channel,)
    assert set(cured) == {f"channels.{name}.delay" for name in together}
    assert all(value == pytest.approx(by, abs=0.06) for value in cured.values())


def test_controls_that_are_late_are_not_a_pose_that_is_early_where_the_wheels_roll_with_it() -> None:
    log = _late("position", 0.0)
    for topic in ("pedals", "steering"):
        log = log.restamp(topic, lambda time: time + 0.4)
    wheels = {"topic": "wheels", "fields": ["rear"], "scale": 0.04}
    findings = inspect_log(log, edited(rig(), [Edit("channels.wheel_speed", wheels)])).findings
    assert "position" not in {f.where for f in findings if f.severity == "warning"}
    cures = {edit.key: edit.value for f in findings for cure in f.cures[:1] for edit in cure}
    assert {"channels.throttle.delay", "channels.steer.delay"} <= set(cures)
    assert all(0.25 < value < 0.55 for key, value in cures.items() if key.endswith(".delay"))
