"""Pedals: rest position, sign, unit, missing effect."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, severe

from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import edited

CLEAN = drive_log(seconds=60)


def test_a_brake_without_effect_shows_none() -> None:
    pressed = np.repeat(np.random.default_rng(2).random(60) > 0.8, 50)
    seldom = CLEAN.change("pedals", "brake", lambda _: 1.0 * pressed)
    (finding,) = (f for f in inspect_log(seldom, rig()).findings if f.where == "brake")
    assert (finding.severity, finding.what) == ("note", "shows no effect on the speed")
    assert "of the time" in finding.evidence


def _triggers(low: float, high: float) -> MemoryLog:
    """The log with pedals as triggers: `high` when released, `low` when pressed fully."""
    return CLEAN.change("pedals", "throttle brake", lambda x: high - (high - low) * np.clip(1.25 * x - 0.25, 0, 1))


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
