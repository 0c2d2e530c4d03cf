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


STEADY_RATE = ('"steer_rate", ', "")  # no longer absent: it is derived of the angle


def test_a_rate_is_derived_while_the_angle_is_silent() -> None:
    steady, changing = stepped("steering", 0.1), rig(STEADY_RATE)
    changing = edited(
        changing, [Edit(f"channels.{name}.interpolation", "on change") for name in ("steer", "steer_angle")]
    )
    held = steady.change("steering", "angle", lambda values: np.where(np.arange(len(values)) < 1000, 0.1, values))
    held = held.change("steering", "command", lambda values: np.where(np.arange(len(values)) < 1000, 0.1, values))
    wanted = extract_rows(drive_from_log(held, rig(STEADY_RATE)))
    found = extract_rows(drive_from_log(on_change(held, "steering"), changing))
    assert found.valid.sum() > 0.98 * wanted.valid.sum()


def test_a_topic_of_another_clock_is_said_also_of_one_that_changes() -> None:
    log = on_change(stepped("pedals", 0.05), "pedals")
    time, columns = log.data["pedals"]
    apart = MemoryLog({**log.data, "pedals": (time - 3600.0, columns)})
    changing = edited(rig(), [Edit(f"channels.{name}.interpolation", "on change") for name in ("throttle", "brake")])
    assert "its clock does not overlap that of odom" in severe(apart, changing)
    late = MemoryLog({**log.data, "pedals": (time + 20.0, columns)})
    assert "starts late or stops early" in severe(late, changing)
    back = log.keep("pedals", np.r_[100:200, 0:100, 200 : len(time)])
    assert any("order" in what or "go back" in what for what in severe(back, changing))


@pytest.mark.parametrize("changes", [0, 1, 5, 40])
def test_a_gear_is_found_however_seldom_it_changes(changes: int) -> None:
    at = np.linspace(CLEAN.data["odom"][0][0] + 0.1, CLEAN.data["odom"][0][-1] - 1, changes + 1)
    log = MemoryLog({**CLEAN.data, "box": (at, {"selected": 1.0 - np.arange(len(at)) % 2})})
    geared = rig(("[channels.throttle]", '[channels.gear]\ntopic = "box"\nfields = ["selected"]\n[channels.throttle]'))
    found = inspect_log(log, geared)
    said = [f.what for f in found.findings if f.severity != "note"]
    assert said == [WHAT if changes else "channel 'gear' (topic 'box') has no usable samples"]
    assert Edit("channels.gear.interpolation", "on change") in found.cure
    assert not any(edit.key == "clock.max_gap" for edit in found.cure)
    drive = drive_from_log(log, edited(geared, [Edit("channels.gear.interpolation", "on change")]))
    assert extract_rows(drive).valid.mean() > 0.95
    box = drive.channels["gear"]
    np.testing.assert_array_equal(box.hold(at, max_gap=0.5)[:, 0], log.data["box"][1]["selected"])


def test_a_gear_that_is_published_steadily_is_none() -> None:
    time = CLEAN.data["odom"][0][::10]
    log = MemoryLog({**CLEAN.data, "box": (time, {"selected": 1.0 - np.arange(len(time)) % 2})})
    geared = rig(("[channels.throttle]", '[channels.gear]\ntopic = "box"\nfields = ["selected"]\n[channels.throttle]'))
    assert WHAT not in severe(log, geared)


@pytest.mark.parametrize("noisy", [False, True], ids=["alone", "beside a voltage that no channel reads"])
@pytest.mark.parametrize("topic", ["pedals", "steering"])
@pytest.mark.parametrize("lost", ["at random", "in bursts"])
def test_samples_that_are_lost_are_not_taken_for_it(topic: str, lost: str, noisy: bool) -> None:
    count, draw = len(CLEAN.data[topic][0]), np.random.default_rng(1)
    time, columns = CLEAN.data[topic]
    more = {"voltage": 12.4 + 0.02 * draw.standard_normal(count)} if noisy else {}
    log = MemoryLog({**CLEAN.data, topic: (time, columns | more)})
    kept = draw.random(count) < 0.1
    if lost == "in bursts":
        kept[:] = True
        for begin in draw.integers(0, count - 100, 12):
            kept[begin : begin + draw.integers(30, 100)] = False
    assert WHAT not in severe(log.keep(topic, kept), rig())
