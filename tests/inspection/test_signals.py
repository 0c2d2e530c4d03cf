"""Single signals with known faults, and signals that only look like it."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.inspect import inspect_log
from offpiste.rig.edits import Edit


def test_nan_and_infinity_are_counted() -> None:
    def broken(x: np.ndarray) -> np.ndarray:
        x[10:20], x[30] = np.nan, np.inf
        return x

    log = drive_log(seconds=60).change("pedals", "throttle", broken)
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.severity == "warning")
    assert finding.where.startswith("throttle")
    assert finding.evidence == "11 of 3000 samples (0.4%), the first 10, the last 30"


def test_rows_that_a_slower_sensor_leaves_empty_are_no_fault() -> None:
    row = np.arange(3000)
    log = drive_log(seconds=60).change("pedals", "throttle", lambda x: np.where(row % 3 > 0, np.nan, x))
    assert not [f for f in inspect_log(log, rig()).findings if f.severity != "note"]
    lost = log.change("pedals", "throttle", lambda x: np.where((row >= 1000) & (row < 1100), np.nan, x))
    (finding,) = (f for f in inspect_log(lost, rig()).findings if f.what.startswith("values are NaN"))
    assert (finding.severity, finding.where.split(" ")[0]) == ("warning", "throttle")
    assert "the first 1000, the last 1100" in finding.evidence


def test_a_field_that_no_channel_reads_is_only_noted() -> None:
    log = drive_log(seconds=60)
    log = log.change("wheels", "rear", lambda x: np.where(np.arange(len(x)) % 701 == 5, 1e6, x))
    (finding,) = (f for f in inspect_log(log).findings if f.where.startswith("wheels"))
    assert (finding.severity, finding.what) == ("note", "isolated spikes")


@pytest.mark.parametrize("per_second", [1, 1e3, 1e9])
def test_times_since_1970_are_no_measurement(per_second: float) -> None:
    log = drive_log(seed=0)
    time, columns = log.data["pedals"]
    stamps = np.floor(1.7e9 + time) * per_second
    stamps[:5] = 0
    mixed = np.random.default_rng(0).permutation(stamps)
    log = MemoryLog({**log.data, "pedals": (time, {**columns, "stamp.sec": stamps, "other": mixed})})
    beyond = [finding.where for finding in inspect_log(log).findings if "beyond any measurement" in finding.what]
    assert beyond == ["pedals other"]


def test_spikes_among_usual_values_get_no_range_that_would_leave_them() -> None:
    """An engine's speed with spikes of half of its range, and one slow run-up to the top."""
    time = np.arange(3000)
    speed = np.where(time < 400, 10.0 * np.minimum(time, 400 - time), 150 + 20 * np.sin(time / 9))
    spiked = np.where((time % 97 == 5) & (time > 500), 1990.0, speed) + 0.01 * (time % 7)
    spiked[2500] = 9000.0
    log = drive_log(seconds=60).change("wheels", "rear", lambda x: spiked)
    (finding,) = (f for f in inspect_log(log).findings if f.where.startswith("wheels"))
    assert finding.what == "isolated spikes"
    assert finding.remedy == "no range of valid values parts them from the others: take another field"


def test_a_range_for_spikes_of_one_component_holds_the_others_too() -> None:
    """One `valid` interval counts for all components, and the forward velocity is larger than the vertical one."""
    clean = drive_log(seconds=60)
    log = clean.change("odom", "vz", lambda values: np.where(np.arange(len(values)) == 700, 60.0, values))
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.what == "isolated spikes")
    low, high = finding.cures[0][0].value
    forward = clean.data["odom"][1]["vx"]
    assert low < forward.min() <= forward.max() < high < 60.0


@pytest.mark.parametrize("rest", [0.0, 0.1, -0.02, 1.0])
def test_a_brake_that_nobody_pressed_is_kept(rest: float) -> None:
    log = drive_log(seconds=60, braking=0.0).change("pedals", "brake", lambda values: np.full(len(values), rest))
    found = inspect_log(log, rig())
    assert found.cure == ()
    assert [f for f in found.findings if f.severity != "note"] == []
    (note,) = (f for f in found.findings if f.where.startswith("brake"))
    assert ("channels.brake.scale = -1.0, channels.brake.offset = 1.0" in note.remedy) == (rest == 1.0)


def test_a_brake_that_hangs_half_pressed_is_none() -> None:
    log = drive_log(seconds=60).change("pedals", "brake", lambda values: np.full(len(values), 0.5))
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.severity != "note")
    assert finding.cures[0][0] == Edit("channels.brake", None)


@pytest.mark.parametrize("lost", [np.nan, 0.0])
def test_a_motion_capture_that_loses_the_vehicle_once_has_one_warning(lost: float) -> None:
    """Its pose and the velocities that it estimates are not numbers, or zero, for 75 samples."""
    log = drive_log()
    for field in log.data["odom"][1]:
        log = log.change("odom", field, lambda x: np.where(np.abs(np.arange(len(x)) - 2537) < 38, lost, x))
    (finding,) = (f for f in inspect_log(log, rig()).findings if f.severity != "note")
    assert "2500" in finding.evidence
    if np.isnan(lost):
        assert finding.where == "position, orientation, linear_velocity, angular_velocity"
        assert "75 of 4500 samples" in finding.evidence
        assert "odom x" in finding.evidence


def test_fields_that_no_channel_reads_and_lack_the_same_samples_are_named_together() -> None:
    log = drive_log(seconds=60)
    time, _ = log.data["pedals"]
    log = MemoryLog({**log.data, "arm": (time, {f"joint {i}": np.full(len(time), np.nan) for i in range(6)})})
    (finding,) = (f for f in inspect_log(log).findings if f.what.startswith("values are NaN"))
    assert finding.where == "arm joint 0, arm joint 1, arm joint 2, arm joint 3 and 2 more"
    assert (finding.severity, finding.remedy) == ("note", "nothing: no channel reads it")


def test_channels_that_are_not_finite_in_other_samples_have_warnings_of_their_own() -> None:
    row = np.arange(4500)
    log = drive_log().change("odom", "vx", lambda x: np.where(abs(row - 1000) < 10, np.nan, x))
    log = log.change("odom", "wz", lambda x: np.where(abs(row - 2000) < 10, np.nan, x))
    found = {f.where for f in inspect_log(log, rig()).findings if f.severity != "note"}
    assert found == {"linear_velocity (odom vx)", "angular_velocity (odom wz)"}
