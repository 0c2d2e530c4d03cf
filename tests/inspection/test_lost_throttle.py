"""A throttle that is lost is parted from one that is released, by what the vehicle does meanwhile."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.lost_throttle import _push, check_lost_throttle
from offpiste.inspection.pedals import pedal_fits
from offpiste.logs.drive import drive_from_log

CLEAN = drive_log(seconds=120, seed=3)
TIME, PEDALS = CLEAN.data["pedals"]


def _found(log: MemoryLog) -> list[Finding]:
    drive = drive_from_log(log, rig())
    path = driven_path(drive)
    return check_lost_throttle(pedal_fits(drive, path)["throttle"], drive, path)


def _lost(*starts: int, count: int) -> MemoryLog:
    """The log with the throttle at zero from some samples on."""

    def lose(values: np.ndarray) -> np.ndarray:
        for first in starts:
            values[first : first + count] = 0.0
        return values

    return CLEAN.change("pedals", "throttle", lose)


def _most_pressed(count: int) -> int:
    """First of so many samples in which the throttle is pressed most."""
    return int(np.convolve(PEDALS["throttle"], np.ones(count), "valid").argmax())


@pytest.mark.parametrize("seconds", [1.0, 4.0])
def test_zeros_through_which_the_vehicle_is_driven_on_are_named_with_what_was_pressed(seconds: float) -> None:
    count = round(seconds / 0.02)
    first = _most_pressed(count)
    (finding,) = _found(_lost(first, count=count))
    assert (finding.severity, finding.where) == ("warning", "throttle")
    assert (
        f"once, for {TIME[first + count - 1] - TIME[first]:.1f} s from {TIME[first] - TIME[0]:.2f} s on"
        in finding.evidence
    )
    said = float(finding.evidence.split("that of ")[1].split(" ")[0])
    assert said == pytest.approx(PEDALS["throttle"][first : first + count].mean(), abs=0.15)


def test_a_fit_by_sums_is_least_squares_of_the_rows_that_are_left() -> None:
    drive = drive_from_log(CLEAN, rig())
    path = driven_path(drive)
    push = _push(pedal_fits(drive, path)["throttle"], drive, path)
    for rows in (slice(0, 0), slice(300, 340), slice(1000, 1900)):
        left = push.known.copy()
        left[rows] = False
        expected = np.linalg.lstsq(push.columns[left], push.gained[left], rcond=None)[0]
        np.testing.assert_allclose(push.without(rows), expected, rtol=1e-6, atol=1e-9)


def test_several_losses_are_counted() -> None:
    pressed = np.convolve(PEDALS["throttle"], np.full(100, 0.01), "valid")
    first, second = int(pressed[:2500].argmax()), 3000 + int(pressed[3000:].argmax())
    (finding,) = _found(_lost(first, second, count=100))
    assert finding.evidence.startswith("2 times, 4.0 s in all")


def test_a_throttle_that_is_released_is_none_that_is_lost() -> None:
    released = PEDALS["throttle"] == 0
    runs = np.diff(np.flatnonzero(np.diff(released.astype(int), prepend=0, append=0)).reshape(-1, 2))
    assert (runs > 50).sum() >= 3  # longer than a second
    assert _found(CLEAN) == []


def test_a_brake_that_acts_less_than_usual_is_no_lost_throttle() -> None:
    """On slippery ground a vehicle slows by less than the same brake does elsewhere."""
    count = 200
    first = _most_pressed(count)

    def pressed(values: np.ndarray) -> np.ndarray:
        values[first : first + count] = 0.5
        return values

    lost = _lost(first, count=count)
    assert len(_found(lost)) == 1
    assert _found(lost.change("pedals", "brake", pressed)) == []


def test_a_loss_that_is_too_short_to_show_in_the_acceleration_is_left_out() -> None:
    assert _found(_lost(_most_pressed(20), count=20)) == []


def test_a_throttle_the_wrong_way_round_tells_nothing() -> None:
    assert _found(_lost(_most_pressed(100), count=100).change("pedals", "throttle", lambda values: 1 - values)) == []
