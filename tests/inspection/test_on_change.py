"""Topics that are published only when they change are found, and not taken for topics whose samples are lost."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.dataset.resample import extract_rows
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

CLEAN = drive_log(seed=0)
WHAT = "is published only when it changes"


def stepped(topic: str, step: float) -> MemoryLog:
    """A topic in steps, as of a joystick."""
    log = CLEAN
    for field in log.data[topic][1]:
        log = log.change(topic, field, lambda values: np.round(values / step) * step)
    return log


def on_change(log: MemoryLog, topic: str) -> MemoryLog:
    """The log as it is where only what is new is published."""
    values = np.stack(list(log.data[topic][1].values()), axis=1)
    return log.keep(topic, np.append(True, (np.diff(values, axis=0) != 0).any(axis=1)))


def severe(log: MemoryLog, of_rig) -> set[str]:
    return {f.what for f in inspect_log(log, of_rig).findings if f.severity != "note"}


@pytest.mark.parametrize(
    ("topic", "channels"), [("pedals", ("throttle", "brake")), ("steering", ("steer", "steer_angle"))]
)
@pytest.mark.parametrize("step", [0.02, 0.05])
def test_it_is_found_and_cured(topic: str, channels: tuple[str, ...], step: float) -> None:
    log = on_change(stepped(topic, step), topic)
    found = inspect_log(log, rig())
    (finding,) = (f for f in found.findings if f.severity != "note")
    assert (finding.where, finding.what) == (topic, WHAT)
    assert found.cure == tuple(Edit(f"channels.{name}.interpolation", "on change") for name in channels)
    assert not severe(log, edited(rig(), found.cure))


def test_rows_are_then_those_of_a_log_that_repeats_what_stays() -> None:
    """All rows that the steady log has, and the same controls in them."""
    steady = stepped("pedals", 0.05)
    held = edited(rig(), [Edit(f"channels.{name}.interpolation", "hold") for name in ("throttle", "brake")])
    changing = edited(rig(), [Edit(f"channels.{name}.interpolation", "on change") for name in ("throttle", "brake")])
    wanted = extract_rows(drive_from_log(steady, held))
    found = extract_rows(drive_from_log(on_change(steady, "pedals"), changing))
    cut = extract_rows(drive_from_log(on_change(steady, "pedals"), held))
    np.testing.assert_array_equal(found.time, wanted.time)
    np.testing.assert_array_equal(found.control, wanted.control)
    assert found.valid.sum() == wanted.valid.sum() > 1.5 * cut.valid.sum()


@pytest.mark.parametrize("topic", ["pedals", "steering"])
@pytest.mark.parametrize("lost", ["at random", "in bursts"])
def test_samples_that_are_lost_are_not_taken_for_it(topic: str, lost: str) -> None:
    count, draw = len(CLEAN.data[topic][0]), np.random.default_rng(1)
    kept = draw.random(count) < 0.1
    if lost == "in bursts":
        kept[:] = True
        for begin in draw.integers(0, count - 100, 12):
            kept[begin : begin + draw.integers(30, 100)] = False
    assert WHAT not in severe(CLEAN.keep(topic, kept), rig())
