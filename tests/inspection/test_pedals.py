"""Pedals: rest position, sign, unit, missing effect."""

import numpy as np
import pytest
from simulated import MAX_STEER, START, WHEELBASE, MemoryLog, drive_log, rig, severe

from offpiste.core.conventions import GRAVITY
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import edited

CLEAN = drive_log(seconds=60)


def test_a_brake_that_only_holds_speed_downhill_has_an_effect() -> None:
    """Over the whole drive the slope explains what the brake does; where the throttle is released it shows."""
    log = _downhill(braking=1.5)
    assert not any(f.where == "brake" for f in inspect_log(log, rig()).findings)


def test_a_brake_without_effect_shows_none() -> None:
    (finding,) = (f for f in inspect_log(_downhill(braking=0.0), rig()).findings if f.where == "brake")
    assert (finding.severity, finding.what) == ("note", "shows no effect on the speed")
    assert "of the time" in finding.evidence


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
