"""Controls that end short of their range; and no illness: drivers who press no further, switches, full throttle."""

from pathlib import Path

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.range_ends import check_range_ends, limit_of
from offpiste.logs import open_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.rig import load_rig

CLEAN = drive_log(seed=0)
FULL = drive_log(120.0, seed=3)
"""With the throttle pressed to 1 again and again."""


def _found(log: MemoryLog, *changes: tuple[str, str]) -> list[Finding]:
    return check_range_ends(drive_from_log(log, rig(*changes)))


CUTS = [("pedals", "throttle", "throttle", 0.4), ("steering", "command", "steer", 0.3)]


@pytest.mark.parametrize(("topic", "field", "name", "limit"), CUTS)
def test_a_control_that_is_cut_off_is_named_with_its_limit(topic: str, field: str, name: str, limit: float) -> None:
    log = CLEAN.change(topic, field, lambda values: np.clip(values, -limit, limit))
    (finding,) = _found(log)
    assert (finding.severity, finding.where) == ("warning", name)
    assert f"exactly {limit:g}" in finding.evidence
    assert not finding.cures  # whether it is a scale or a cut, the log does not say


def test_a_scale_is_offered_where_full_throttle_is_pressed_again_and_again() -> None:
    assert _found(FULL) == []
    (finding,) = _found(FULL.change("pedals", "throttle", lambda values: 0.25 * values))
    assert "channels.throttle.scale = 4.0" in finding.remedy


def test_who_presses_no_further_is_healthy() -> None:
    # The largest of a driver's presses comes once, whatever it is.
    gentle = CLEAN.change("pedals", "throttle", lambda values: 0.3 * np.sin(values))
    assert np.sum(gentle.data["pedals"][1]["throttle"] > 0.25) > 100
    assert _found(gentle) == []


def test_a_switch_is_no_limit() -> None:
    log = CLEAN.change("pedals", "brake", lambda values: np.where(values > 0.05, 0.6, 0.0))
    assert np.sum(np.diff(log.data["pedals"][1]["brake"]) > 0) > 5
    assert _found(log) == []


def test_steps_of_a_coarse_lever_are_no_limit() -> None:
    presses = np.repeat([0.1, 0.2, 0.3, 0.4] * 6, 20)
    lever = np.concatenate([np.linspace(0.0, top, 5) for top in presses]).round(1)
    assert limit_of(lever) is None
    assert limit_of(np.minimum(np.concatenate([np.linspace(0, top, 40) for top in presses]), 0.15)) is not None


def test_the_whole_inspection_says_it_once() -> None:
    log = CLEAN.change("steering", "command", lambda values: np.clip(values, -0.3, 0.3))
    about = [f for f in inspect_log(log, rig()).findings if f.where == "steer" and "cut off" in f.what]
    assert len(about) == 1


def test_no_control_of_a_recorded_drive_ends_short_of_its_range(data_folder: Path) -> None:
    recorded = [(path, "dart") for path in data_folder.glob("dart/**/*.csv")]
    recorded += [(path, "tartandrive2") for path in data_folder.glob("tartandrive2/drives/*")]
    assert len(recorded) == 15
    drives = [(path, drive_from_log(open_log(path), load_rig(name))) for path, name in recorded]
    assert [path.name for path, drive in drives if check_range_ends(drive)] == []


def test_a_scale_is_offered_with_the_offset_that_keeps_zero_where_it_is() -> None:
    log = FULL.change("pedals", "throttle", lambda values: 1500 + 100 * values)
    (finding,) = _found(log, ('fields = ["throttle"]', 'fields = ["throttle"]\nscale = 0.0025\noffset = -3.75'))
    assert "channels.throttle.scale = 0.01, channels.throttle.offset = -15.0" in finding.remedy
