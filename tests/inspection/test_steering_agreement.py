"""Command and measured angle of the steering: which of the two has the wrong scale."""

import numpy as np
import pytest
from simulated import MAX_STEER, drive_log, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.steering_agreement import agreement
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited


def share_of(change=lambda angle: angle) -> float:
    drive = drive_from_log(drive_log(seed=0).change("steering", "angle", change), rig())
    found = agreement(drive, driven_path(drive))
    assert found is not None
    assert found.strength > 0.9
    return found.share


def test_the_share_is_that_of_the_two_whatever_their_signs() -> None:
    assert share_of() == pytest.approx(1, abs=0.01)
    assert share_of(lambda angle: -0.7 * angle) == pytest.approx(0.7, abs=0.01)


def test_a_slow_actuator_does_not_change_the_share() -> None:
    """A first-order lag of 0.2 s damps quick steering, but not its mean over a second."""

    def slow(angle: np.ndarray) -> np.ndarray:
        followed, share = angle.copy(), 1 - np.exp(-0.08 / 0.2)
        for i in range(1, len(angle)):
            followed[i] = followed[i - 1] + share * (angle[i] - followed[i - 1])
        return followed

    assert share_of(slow) == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("factor", [0.6, 1.5])
def test_an_angle_that_neither_the_command_nor_the_turning_fits_gets_its_scale(factor: float) -> None:
    log = drive_log(seed=0).change("steering", "angle", lambda angle: factor * angle)
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.severity == "warning")
    assert (finding.where, finding.what) == ("steer_angle", "does not fit the command")
    assert finding.cures[0][0].key == "channels.steer_angle.scale"
    assert float(finding.cures[0][0].value) == pytest.approx(1 / factor, rel=0.03)


def test_a_command_whose_range_no_vehicle_has_gets_its_scale_first() -> None:
    """Two fifths of a command would mean wheels that turn by more than a radian."""
    log = drive_log(seed=0).change("steering", "command", lambda values: 0.4 * values)
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.severity == "warning")
    assert (finding.where, finding.what) == ("steer", "does not fit the wheels' angle")
    assert finding.cures[0][0].key == "channels.steer.scale"
    assert float(finding.cures[0][0].value) == pytest.approx(2.5, rel=0.03)


@pytest.mark.parametrize(
    ("field", "scale", "zero", "keys"),
    [
        ("angle", 2.0, 0.1, ["channels.steer_angle.scale", "channels.steer_angle.offset"]),
        ("command", 0.4, 0.05, ["channels.steer.scale", "channels.steer.offset"]),
    ],
)
def test_a_scale_takes_the_zero_along(field: str, scale: float, zero: float, keys: list[str]) -> None:
    """The zero of the rig is right in the log's numbers; a scale alone would move it."""
    log = drive_log(seed=0).change("steering", field, lambda values: scale * values + zero)
    name = "steer" if field == "command" else "steer_angle"
    given = edited(rig(), [Edit(f"channels.{name}.offset", -zero)])
    (finding,) = (f for f in inspect_log(log, given).findings if f.severity == "warning")
    assert [edit.key for edit in finding.cures[0]] == keys
    assert not [f for f in inspect_log(log, edited(given, finding.cures[0])).findings if f.severity != "note"]


def test_a_linkage_that_is_not_quite_linear_is_healthy() -> None:
    log = drive_log(seed=0).change("steering", "angle", lambda angle: angle * (1 - 0.1 * np.abs(angle) / MAX_STEER))
    assert [f for f in inspect_log(log, rig()).findings if f.severity == "warning"] == []


def test_without_a_measured_angle_there_is_nothing_to_compare() -> None:
    drive = drive_from_log(drive_log(seed=0), rig())
    del drive.channels["steer_angle"]
    assert agreement(drive, driven_path(drive)) is None
