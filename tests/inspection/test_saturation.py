"""Channels that are cut off: distinguished from a full lock by how far the vehicle turns there."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, steered

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
    _, columns = CLEAN.data["steering"]
    command = np.clip(columns["command"], -limit, limit)
    assert np.mean(np.abs(command) >= limit) > 0.02
    assert _found(steered(CLEAN, command, follows=0.0)) == []


@pytest.mark.parametrize(("largest", "found"), [(1.0, []), (0.7, ["steer"])])
def test_slow_wheels_turn_furthest_where_full_lock_is_held(largest: float, found: list[str]) -> None:
    """A command that ends at 1 has no more to give; one that ends below may be cut off."""
    random = np.random.default_rng(3)
    stamps, _ = CLEAN.data["steering"]
    held = np.repeat(random.choice([-1.0, 1.0], 200), 12)[: len(stamps) // 5]
    quick = 0.97 * np.sin(0.25 * np.arange(len(stamps) - len(held)))
    command = largest * np.concatenate((held, quick))
    assert [f.where for f in _found(steered(CLEAN, command, follows=0.15))] == found


def test_a_clean_log_is_not_cut_off() -> None:
    assert _found(CLEAN) == []
