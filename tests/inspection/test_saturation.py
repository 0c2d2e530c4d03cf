"""Channels that are cut off: distinguished from a full lock by how far the vehicle turns there."""

import numpy as np
import pytest
from simulated import MAX_STEER, WHEELBASE, MemoryLog, drive_log, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.saturation import check_saturation
from offpiste.logs.drive import drive_from_log

CLEAN = drive_log(seed=0)


def _found(log: MemoryLog, *changes: tuple[str, str]) -> list[Finding]:
    drive = drive_from_log(log, rig(*changes))
    return check_saturation(drive, driven_path(drive))


@pytest.mark.parametrize(("field", "name", "limit"), [("command", "steer", 0.3), ("angle", "steer_angle", 0.1)])
def test_a_steering_that_is_cut_off_is_named_with_its_limit(field: str, name: str, limit: float) -> None:
    (finding,) = _found(CLEAN.change("steering", field, lambda values: np.clip(values, -limit, limit)))
    assert (finding.severity, finding.where) == ("warning", name)
    assert f"of its samples are {limit:g}" in finding.evidence


def test_a_yaw_rate_that_is_cut_off_is_named() -> None:
    log = CLEAN.change("odom", "wz", lambda values: np.clip(values, -0.3, 0.3))
    swapped = ('[channels.angular_velocity]\ntopic = "odom"\nfields = ["wx", "wy", "wz"]\nframe = "body"',
               '[channels.yaw_rate]\ntopic = "odom"\nfields = ["wz"]')  # fmt: skip
    (finding,) = _found(log, swapped)
    assert finding.where == "yaw_rate"


def test_full_lock_is_no_cut() -> None:
    """The wheels stop where the command does: the vehicle turns no further."""
    limit = 0.5
    time, columns = CLEAN.data["steering"]
    command = np.clip(columns["command"], -limit, limit)
    odom_time, odom = CLEAN.data["odom"]
    v = np.interp(odom_time, odom_time, odom["vx"])
    rate = v * np.tan(MAX_STEER * np.interp(odom_time, time, command)) / WHEELBASE
    yaw = np.cumsum(rate) * 0.02
    x, y = np.cumsum(v * np.cos(yaw)) * 0.02, np.cumsum(v * np.sin(yaw)) * 0.02
    columns = odom | {"x": x, "y": y, "qz": np.sin(yaw / 2), "qw": np.cos(yaw / 2)}
    log = MemoryLog({**CLEAN.data, "odom": (odom_time, columns)})
    log = log.change("steering", "command", lambda _: command)
    assert np.mean(np.abs(command) >= limit) > 0.02
    assert _found(log) == []


def test_a_clean_log_is_not_cut_off() -> None:
    assert _found(CLEAN) == []
