"""Pedals: one that never comes back to zero, one that drives backwards."""

import numpy as np
from simulated import drive_log, rig

from offpiste.inspection.inspect import inspect_log
from offpiste.rig.edits import Edit

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
