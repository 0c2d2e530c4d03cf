"""Gears against the motion: read rightly nothing is said, read wrongly the right reading is proposed."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from factories import MemoryLog as Plain
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.driven_path import DrivenPath, driven_path
from offpiste.inspection.gear import check_gear
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.recorded_log import Recorded, RememberedLog, read_topics
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.logs.log import open_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import parse_rig

FORWARD = drive_log(seconds=60)
GEAR = ("[channels.throttle]", '[channels.gear]\ntopic = "box"\nfields = ["selected"]\n[channels.throttle]')


def _reversing(log: MemoryLog, begin: float, end: float) -> MemoryLog:
    """The log with its heading turned round for a stretch: there the vehicle reverses along its path."""
    time, odom = log.data["odom"]
    back = (time - time[0] > begin) & (time - time[0] < end)
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"]) + np.pi * back
    return log.put("odom", qz=np.sin(yaw / 2), qw=np.cos(yaw / 2))


def _with_gear(log: MemoryLog, begin: float, end: float, forward: float, reverse: float) -> MemoryLog:
    time, _ = log.data["odom"]
    back = (time - time[0] > begin) & (time - time[0] < end)
    log.data["box"] = time, {"selected": np.where(back, reverse, forward)}
    return log


def _read(log: MemoryLog, *more: tuple[str, str]) -> tuple[Drive, DrivenPath, dict[str, Recorded]]:
    drive = drive_from_log(log, rig(*more))
    return drive, driven_path(drive), read_topics(RememberedLog(log), None)[0]


def test_reversing_without_a_gear_is_noted() -> None:
    drive, path, recorded = _read(_reversing(FORWARD, -1.0, 61.0))
    pressed = replace(drive.channels["throttle"], values=np.full_like(drive.channels["throttle"].values, 0.4))
    drive = replace(drive, channels={**drive.channels, "throttle": pressed})
    (finding,) = check_gear(drive, path, recorded)
    assert finding.severity == "note"
    assert "is not read, and the vehicle reverses" in finding.what
    released = replace(pressed, values=np.zeros_like(pressed.values))
    assert check_gear(replace(drive, channels={**drive.channels, "throttle": released}), path, recorded) == []


def test_a_gear_that_goes_with_the_motion_is_right_and_one_that_does_not_is_found() -> None:
    log = _with_gear(_reversing(FORWARD, 20.0, 40.0), 20.0, 40.0, 3.0, 1.0)
    drive, path, recorded = _read(log, GEAR)
    (finding,) = check_gear(drive, path, recorded)
    assert finding.severity == "warning"
    ((edit,),) = finding.cures
    assert edit.value == {"1": -1.0, "3": 1.0}
    cured = drive_from_log(log, edited(rig(GEAR), [edit]))
    assert check_gear(cured, driven_path(cured), recorded) == []


@pytest.mark.parametrize(
    ("field", "recorded", "meanings"),
    [
        ("gear", (-1.0, 1.0, 2.0), {}),
        ("prndl", (0.0, 1.0, 3.0), {"0": 0, "1": -1, "2": 0, "3": 1}),
        ("gear_letter", (82.0, 68.0), {"P": 0, "R": -1, "N": 0, "D": 1}),
        ("gear_letter", (82.0, 68.0, 83.0), {"P": 0, "R": -1, "N": 0, "D": 1, "S": 1}),
        ("gear", (82.0, 78.0, 1.0, 2.0), {"P": 0, "R": -1, "N": 0, "D": 1, "1": 1, "2": 1}),
        ("gear_shift", (0.0, 1.0, 3.0), {}),
        ("shift_rpt.output", (0.0, 1.0, 3.0), {}),
        ("reverse", (0.0, 1.0), {"0": 1, "1": -1}),
    ],
)
def test_first_rigs_have_the_gear(field: str, recorded: tuple[float, ...], meanings: dict[str, int]) -> None:
    time = np.arange(100) / 10
    pose = dict.fromkeys(("x", "y", "yaw"), time)
    log = Plain(box=(time, {field: np.resize(recorded, 100), "gear_ratio": time, **pose}))
    source = parse_rig(draft_rig(log), where="test").channels["gear"]
    assert source.fields == (field,)
    assert source.values == meanings


def _one_pedal(path, *, reverses: bool, full: float = 1.0, rest: float = 0.0):
    """A table of a vehicle with one signed pedal: below zero it drives backwards, or brakes while it rolls back."""
    time = np.arange(0, 120, 0.02)
    wanted = 3 * np.sin(0.25 * time) + 1.5
    steering, slope = 0.3 * np.sin(0.37 * time), -0.12  # downhill where it goes backwards
    x, y, yaw, speed, rows = 0.0, 0.0, 0.3, 0.0, []
    for t, want, steer in zip(time, wanted, steering, strict=True):
        if reverses:
            pedal = np.clip(0.5 * (want - speed) + 0.1 * want, -0.6, 1.0)
            force = 5 * pedal
        else:
            pedal = np.clip(0.8 * (want - speed), -1.0, 1.0) if want > 0 else -0.1 - 0.4 * np.clip(-speed - 0.5, 0, 1)
            force = 5 * pedal if pedal > 0 else 9.81 * slope * (want < 0) - 6 * abs(pedal) * np.sign(speed)
        rows.append((t, x, y, yaw, steer, rest + full * pedal))
        speed += 0.02 * (force - 0.4 * speed)
        yaw += 0.02 * speed * np.tan(0.5 * steer) / 2
        x, y = x + 0.02 * speed * np.cos(yaw), y + 0.02 * speed * np.sin(yaw)
    np.savetxt(path, rows, delimiter=",", header="t,x,y,yaw,steering,throttle", comments="", fmt="%.6f")
    return open_log(path)


@pytest.mark.parametrize(
    ("full", "rest", "gear"),
    [
        (1.0, 0.0, ("scale = 25.0",)),
        (100.0, 0.0, ("scale = 0.25",)),
        (500.0, 1500.0, ("scale = 0.05", "offset = -75.0")),
    ],
)
def test_first_rigs_have_a_gear_where_one_pedal_drives_both_ways(tmp_path, full, rest, gear) -> None:
    log = _one_pedal(tmp_path / "drive.csv", reverses=True, full=full, rest=rest)
    drafted = parse_rig(draft_rig(log), where="test")
    assert "brake" not in drafted.channels
    assert drafted.channels["throttle"].absolute
    assert drafted.channels["gear"].fields == ("throttle",)
    assert all(line in draft_rig(log) for line in gear)
    drive = drive_from_log(log, drafted)
    gears, speed = drive.channels["gear"].values[:, 0], driven_path(drive).forward
    assert {*np.unique(gears)} == {-1.0, 0.0, 1.0}
    assert speed.min() < -0.5
    assert 0.4 < drive.channels["throttle"].values.max() <= 1
    assert check_gear(drive, driven_path(drive), read_topics(RememberedLog(log), None)[0]) == []


def test_a_reverse_that_a_rig_reads_as_the_brake_is_found_with_the_edits_that_make_it_the_gear(tmp_path) -> None:
    log = _one_pedal(tmp_path / "drive.csv", reverses=True)
    given = edited(
        parse_rig(draft_rig(log), where="test"),
        (
            Edit("channels.throttle.absolute", False),
            Edit("channels.gear", None),
            Edit("channels.brake", {"fields": ["throttle"], "sign": -1, "clip": [0.0, 1.0]}),
            Edit("absent", ["brake_pressure", "steer_angle", "steer_rate", "engine_rpm"]),
        ),
    )
    found = {(f.where, f.what): f for f in inspect_log(log, given).findings}
    finding = found["brake", "is reverse, and no brake"]
    assert not any(what == "acts the wrong way" for _, what in found)
    cured = edited(given, finding.cures[0])
    assert cured.channels["gear"].scale == 25.0
    assert "brake" in cured.absent
    assert not {"brake", "gear", "throttle"} & {f.where for f in inspect_log(log, cured).findings}


def test_a_brake_below_zero_stays_one_where_the_vehicle_rolls_back(tmp_path) -> None:
    log = _one_pedal(tmp_path / "drive.csv", reverses=False)
    drafted = parse_rig(draft_rig(log), where="test")
    assert driven_path(drive_from_log(log, drafted)).forward.min() < -0.5
    assert drafted.channels["brake"].sign == -1
    assert "gear" not in drafted.channels
