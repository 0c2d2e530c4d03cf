"""Pedals: rest position, sign, unit, missing effect, lost samples."""

import numpy as np
import pytest
from simulated import MAX_STEER, START, WHEELBASE, MemoryLog, drive_log, rig, severe

from offpiste.core.conventions import GRAVITY
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.lost_throttle import check_lost_throttle
from offpiste.inspection.pedals import pedal_fits
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

CLEAN = drive_log(seconds=60)


def test_a_pedal_with_an_idle_offset_is_brought_back_to_zero() -> None:
    found = inspect_log(CLEAN.change("pedals", "throttle", lambda x: 0.2 + 0.8 * x), rig())
    assert Edit("channels.throttle.offset", -0.2) in found.cure


def test_a_pedal_that_the_driver_never_releases_is_no_fault() -> None:
    pressed = CLEAN.change("pedals", "brake", lambda x: 0.0 * x + 1e-3 * np.arange(len(x)) / len(x))
    found = inspect_log(pressed.change("pedals", "throttle", lambda x: np.maximum(x, 0.15)), rig())
    assert not any("zero" in f.what and f.severity != "note" for f in found.findings)


def test_swapped_pedals_are_exchanged() -> None:
    _, pedals = CLEAN.data["pedals"]
    throttle, brake = pedals["throttle"].copy(), pedals["brake"].copy()
    log = CLEAN.change("pedals", "throttle", lambda _: brake).change("pedals", "brake", lambda _: throttle)
    cure = {edit.key: edit.value for edit in inspect_log(log, rig()).cure}
    assert cure["channels.throttle.fields"] == ["brake"]
    assert cure["channels.brake.fields"] == ["throttle"]


def test_a_brake_that_only_holds_speed_downhill_has_an_effect() -> None:
    """Over the whole drive the slope explains what the brake does; where the throttle is released it shows."""
    log = _downhill(braking=1.5)
    assert not any(f.where == "brake" for f in inspect_log(log, rig()).findings)


def test_a_brake_without_effect_shows_none() -> None:
    (finding,) = (f for f in inspect_log(_downhill(braking=0.0), rig()).findings if f.where == "brake")
    assert (finding.severity, finding.what) == ("note", "shows no effect on the speed")
    assert "of the time" in finding.evidence


def test_a_brake_that_is_dead_shows_where_the_vehicle_brakes_without_it() -> None:
    dead = inspect_log(CLEAN.change("pedals", "brake", lambda x: 0.0 * x), rig())
    (finding,) = (f for f in dead.findings if f.where == "brake" and f.severity != "note")
    assert finding.what == "is never pressed, and the vehicle brakes"
    assert Edit("channels.brake", None) in dead.cure


def test_a_vehicle_that_only_rolls_out_was_not_braked() -> None:
    """Uphill slopes and drag slow it down, and the brake stays where it is."""
    log = _downhill(braking=-6.0).change("pedals", "brake", lambda x: 0.0 * x)
    assert driven_path(drive_from_log(log, rig())).acceleration.min() < -2.5
    found = inspect_log(log, rig())
    assert not any(f.where == "brake" and f.severity != "note" for f in found.findings)


def _downhill(braking: float) -> MemoryLog:
    """A drive over bumps, with the brake pressed seldom, and then down a slope that it holds the vehicle on.

    Args:
        braking: what the brake really does at full pedal [m/s^2]; the slope is as steep.
    """
    random = np.random.default_rng(4)
    dt, seconds = 0.01, 160.0
    time = np.arange(0, seconds, dt)
    down = (time % 20) > 16
    throttle = np.where(
        down, 0.0, np.clip(0.4 + 0.3 * np.interp(time, time[::200], random.normal(size=len(time) // 200)), 0, 1)
    )
    brake = np.where((time % 40) > 38, 1.0, 0.0)
    bumps = np.interp(time, time[::50], random.normal(size=len(time) // 50))
    slope = np.where(brake > 0, -braking / GRAVITY, 0.0)
    v, z = np.full(len(time), 4.0), np.zeros(len(time))
    for i in range(1, len(time)):
        push = 3.0 * throttle[i] - braking * brake[i] - 0.25 * v[i - 1] - GRAVITY * slope[i] + bumps[i]
        v[i] = max(v[i - 1] + dt * push, 1.0)
        z[i] = z[i - 1] + dt * v[i] * slope[i]
    steer = 0.4 * np.sin(time / 3)
    yaw_rate = v * np.tan(MAX_STEER * steer) / WHEELBASE
    yaw = np.cumsum(yaw_rate) * dt
    x, y = np.cumsum(v * np.cos(yaw)) * dt, np.cumsum(v * np.sin(yaw)) * dt
    zero = np.zeros(len(time))
    half = yaw / 2
    odom = {"x": x, "y": y, "z": z, "qx": zero, "qy": zero, "qz": np.sin(half), "qw": np.cos(half)}
    odom |= {"vx": v, "vy": zero, "vz": zero, "wx": zero, "wy": zero, "wz": yaw_rate}
    odom = {field: column[::2] + 1e-3 * random.standard_normal(len(column[::2])) for field, column in odom.items()}
    return MemoryLog(
        {
            "odom": (START + time[::2], odom),
            "pedals": (START + time[::2], {"throttle": throttle[::2], "brake": brake[::2]}),
            "steering": (START + time[::4], {"command": steer[::4], "angle": MAX_STEER * steer[::4]}),
        }
    )


@pytest.mark.parametrize(
    ("pedal", "unit", "factor", "cure"),
    [
        ("throttle", "", 0.01, Edit("channels.throttle.scale", 100.0)),
        ("throttle", "percent", 1.0, Edit("channels.throttle.unit", "1")),
        ("brake", "percent", 1.0, Edit("channels.brake.unit", "1")),
    ],
)
def test_a_pedal_that_moves_the_vehicle_as_none_could_is_in_another_unit(pedal, unit, factor, cure) -> None:
    log = CLEAN.change("pedals", pedal, lambda x: factor * x)
    field = f'fields = ["{pedal}"]'
    found = inspect_log(log, rig((field, f'{field}\nunit = "{unit}"' if unit else field)))
    assert cure in found.cure
    (finding,) = [f for f in found.findings if f.what == "is too small for what it does"]
    assert (finding.severity, finding.where) == ("warning", pedal)


def _triggers(low: float, high: float) -> MemoryLog:
    """The log with pedals as triggers: `high` when released, `low` when pressed fully."""
    log = CLEAN
    log = log.change("pedals", "throttle brake", lambda x: high - (high - low) * np.clip(1.25 * x - 0.25, 0, 1))
    return log


@pytest.mark.parametrize("low", [-1.0, 0.0])
def test_two_triggers_that_rest_high_are_both_reversed_and_not_exchanged(low: float) -> None:
    log = _triggers(low, 1.0)
    inspection = inspect_log(log, rig())
    cured = edited(rig(), inspection.cure)
    assert [cured.channels[name].fields for name in ("throttle", "brake")] == [("throttle",), ("brake",)]
    channels = drive_from_log(log, cured).channels
    for name in ("throttle", "brake"):
        pressed = np.clip(1.25 * CLEAN.data["pedals"][1][name] - 0.25, 0, 1)
        np.testing.assert_allclose(channels[name].values[:, 0], pressed, atol=1e-3)
    assert not severe(log, cured)


def test_a_brake_that_is_never_released_is_the_wrong_way_round() -> None:
    """Also where it is used too little to show an effect."""
    rare = CLEAN.change("pedals", "brake", lambda x: 1.0 - 0.7 * (np.arange(len(x)) % 500 < 30))
    finding = next(f for f in inspect_log(rare, rig()).findings if f.where == "brake")
    assert (finding.severity, finding.what) == ("warning", "is pressed all the time")
    cured = edited(rig(), finding.cures[0])
    assert drive_from_log(rare, cured).channels["brake"].values.min() == pytest.approx(0.0, abs=1e-6)
    assert not [f for f in inspect_log(rare, cured).findings if f.where == "brake" and f.severity != "note"]


LONG = drive_log(seconds=120, seed=3)
TIME, PEDALS = LONG.data["pedals"]


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

    return LONG.change("pedals", "throttle", lose)


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


def test_a_throttle_that_is_released_is_none_that_is_lost() -> None:
    released = PEDALS["throttle"] == 0
    runs = np.diff(np.flatnonzero(np.diff(released.astype(int), prepend=0, append=0)).reshape(-1, 2))
    assert (runs > 50).sum() >= 3  # longer than a second
    assert _found(LONG) == []


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
