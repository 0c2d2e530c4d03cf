"""Steps between values: coarse ones are named with their size, fine ones and switches are not."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.resolution import check_resolution
from offpiste.logs.drive import drive_from_log

CLEAN = drive_log(seed=0)


def _found(log: MemoryLog) -> list[Finding]:
    drive = drive_from_log(log, rig())
    return check_resolution(drive, driven_path(drive))


def _stepped(topic: str, fields: tuple[str, ...], step: float) -> MemoryLog:
    log = CLEAN
    for field in fields:
        log = log.change(topic, field, lambda values: np.round(values / step) * step)
    return log


@pytest.mark.parametrize(
    ("topic", "fields", "where", "step"),
    [
        ("odom", ("x", "y"), "position", 0.5),
        ("odom", ("vx", "vy", "vz"), "linear_velocity", 2.0),
        ("steering", ("command",), "steer", 0.3),
        ("steering", ("angle",), "steer_angle", 0.1),
    ],
)
def test_coarse_steps_are_named_with_their_size(topic: str, fields: tuple[str, ...], where: str, step: float) -> None:
    (finding,) = _found(_stepped(topic, fields, step))
    assert (finding.severity, finding.where, finding.what) == ("warning", where, "is recorded in coarse steps")
    assert f"{step:g}" in finding.evidence


@pytest.mark.parametrize(
    ("topic", "fields", "step"),
    [("odom", ("x", "y"), 0.01), ("odom", ("vx", "vy", "vz"), 0.01), ("steering", ("command",), 0.02)],
)
def test_fine_steps_do_no_harm(topic: str, fields: tuple[str, ...], step: float) -> None:
    assert _found(_stepped(topic, fields, step)) == []


def test_single_precision_far_from_the_origin_shows_in_one_axis_alone() -> None:
    """Northings in float32 have steps of 0.5 m, eastings of 0.03 m: the coarser decides."""
    log = CLEAN.change("odom", "x", lambda values: (412_000 + values).astype(np.float32).astype(float))
    log = log.change("odom", "y", lambda values: (5_312_000 + values).astype(np.float32).astype(float))
    (finding,) = _found(log)
    assert finding.where == "position"
    assert "multiples of 0.5" in finding.evidence


def test_a_steering_by_keys_leaps_between_its_values() -> None:
    random = np.random.default_rng(0)

    def by_keys(values: np.ndarray) -> np.ndarray:
        return np.repeat(random.choice([-1.0, -0.5, 0.0, 0.5, 1.0], len(values) // 20 + 1), 20)[: len(values)]

    assert _found(CLEAN.change("steering", "command", by_keys)) == []


def test_a_clean_log_and_a_channel_that_never_changes_have_no_steps() -> None:
    assert _found(CLEAN) == []
    assert _found(CLEAN.change("steering", "command", np.zeros_like)) == []
