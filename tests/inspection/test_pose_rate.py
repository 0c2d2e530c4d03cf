"""Poses that are measured more rarely than they are recorded, or than velocities need."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.core.errors import LogError
from offpiste.dataset.resample import extract_rows
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.channel import repeated
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig

CLEAN = drive_log(seconds=60)
PLACE_ONLY = edited(rig(), [Edit("channels.linear_velocity", None), Edit("channels.angular_velocity", None)])
TIME, ODOM = CLEAN.data["odom"]
EVERY = round(0.1 / float(np.median(np.diff(TIME))))
"""Samples in a tenth of a second."""


def _posed(time: np.ndarray, rows: np.ndarray) -> MemoryLog:
    return MemoryLog(CLEAN.data | {"odom": (time, {name: values[rows] for name, values in ODOM.items()})})


def test_places_that_come_too_seldom_to_differentiate_get_a_wider_window() -> None:
    rows = np.arange(0, len(TIME), EVERY)
    log = _posed(TIME[rows], rows)
    (finding,) = (f for f in inspect_log(log, PLACE_ONLY).findings if f.severity == "fatal")
    assert finding.what == "comes too seldom to differentiate"
    assert extract_rows(drive_from_log(log, edited(PLACE_ONLY, finding.cures[0]))).valid.mean() > 0.9
    with pytest.raises(LogError, match="of 'state"):
        extract_rows(drive_from_log(log, PLACE_ONLY))


def test_rows_that_hold_the_last_value_are_left_out_by_the_cure() -> None:
    log = _posed(TIME, np.arange(len(TIME)) // EVERY * EVERY)
    (finding,) = (f for f in inspect_log(log, PLACE_ONLY).findings if f.severity == "warning")
    assert finding.what == "repeats its last value"
    cured = edited(PLACE_ONLY, finding.cures[0])
    assert cured.channels["position"].repeats == cured.channels["orientation"].repeats == "drop"
    assert [f for f in inspect_log(log, cured).findings if f.severity != "note"] == []
    true, held, left = (_speed(*each) for each in ((CLEAN, rig()), (log, PLACE_ONLY), (log, cured)))
    assert np.nanstd(left - true) < 0.6 * np.nanstd(held - true)


@pytest.mark.parametrize("held", [[2], [2, 3]])
def test_rows_that_hold_a_value_for_two_or_three_are_found(held: list[int]) -> None:
    """20 or 25 places a second in 50 rows: less than six in ten repeat."""
    first = np.cumsum(np.resize(held, len(TIME)))
    log = _posed(TIME, np.minimum(first[np.searchsorted(first, np.arange(len(TIME)), "right")] - 1, len(TIME) - 1))
    (finding,) = (f for f in inspect_log(log, PLACE_ONLY).findings if f.what == "repeats its last value")
    assert edited(PLACE_ONLY, finding.cures[0]).channels["position"].repeats == "drop"


@pytest.mark.parametrize("resolution", [0.02, 0.1])
def test_places_that_are_rounded_hold_nothing(resolution: float) -> None:
    rounded = {name: np.round(ODOM[name] / resolution) * resolution for name in ("x", "y")}
    log = MemoryLog(CLEAN.data | {"odom": (TIME, ODOM | rounded)})
    assert not any(f.what == "repeats its last value" for f in inspect_log(log, PLACE_ONLY).findings)


def _speed(log: MemoryLog, now: Rig) -> np.ndarray:
    """Forward speed as known at the time, every 20 ms of the log's middle."""
    rows = extract_rows(drive_from_log(log, now))
    return np.interp(np.arange(TIME[0] + 5, TIME[-1] - 5, 0.02), rows.time, rows.state_causal[:, 3])


def test_a_vehicle_that_stands_is_measured_again_and_again() -> None:
    time = np.arange(0, 2, 0.01)
    values = np.where(time < 1, np.floor(time * 10), 10.0)[:, None]  # ten a second, then none
    kept = time[~repeated(time, values)]
    np.testing.assert_allclose(kept[kept < 1], np.arange(0, 1, 0.1), atol=0.011)
    assert 3 <= (kept >= 1).sum() <= 5
    assert np.diff(kept).max() < 0.3


def test_a_clean_log_repeats_nothing() -> None:
    assert not any(f.what == "repeats its last value" for f in inspect_log(CLEAN, rig()).findings)
