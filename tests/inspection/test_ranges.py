"""Ranges of controls: units, scales, wrapping counters, cut-off values, coarse steps and dropped samples."""

from pathlib import Path

import numpy as np
import pytest
from simulated import MemoryLog, checked, drive_log, rig, severe, steered

from offpiste.inspection.dropped import check_dropped
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.range_ends import check_range_ends
from offpiste.inspection.recorded_log import RememberedLog, read_topics
from offpiste.inspection.resolution import check_resolution
from offpiste.inspection.saturation import check_saturation
from offpiste.inspection.usual_ranges import whole_range
from offpiste.logs import open_log
from offpiste.logs.channel import read_channel
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, load_rig

CLEAN = drive_log(seconds=60)


def cures(log, **entries):
    field = 'fields = ["brake"]'
    lines = "\n".join(f"{key} = {value}" for key, value in entries.items())
    return inspect_log(log, rig((field, f"{field}\n{lines}"))).cure


@pytest.mark.parametrize("period", [65536.0, 6553.6])
def test_a_counter_that_stays_below_zero_is_unwrapped(period):
    counts = -150 + 20 * np.random.default_rng(0).standard_normal(len(CLEAN.data["pedals"][0]))
    log = CLEAN.change("pedals", "brake", lambda x: (counts + 65536) * period / 65536)
    scale = 65536 / period / 3000
    assert cures(log, scale=scale, offset=0.05) == (
        Edit("channels.brake.wrap", {"above": period / 2, "period": period}),
    )


@pytest.mark.parametrize(("full", "reached"), [(255.0, 0.6), (1023.0, 1.0), (4095.0, 1.0)])
def test_counts_get_the_range_that_loggers_write_not_what_one_log_reached(full, reached):
    (scale,) = cures(CLEAN.change("pedals", "brake", lambda x: full * reached * x / x.max()))
    assert (scale.key, scale.value) == ("channels.brake.scale", pytest.approx(1 / full, rel=1e-3))


def test_a_steering_that_the_rig_cuts_off_is_named_and_one_at_its_ends_is_not():
    log = CLEAN.change("steering", "command", lambda x: 2.5 * x / np.abs(x).max())
    field = 'fields = ["command"]'
    clipped = rig((field, f"{field}\nclip = [-1.0, 1.0]"))
    (finding,) = (f for f in inspect_log(log, clipped).findings if f.where == "steer" and "clipped" in f.what)
    assert finding.severity == "warning"
    at_its_ends = CLEAN.change("steering", "command", lambda x: np.clip(1.4 * x / np.abs(x).max(), -1.01, 1.01))
    assert not [f for f in inspect_log(at_its_ends, clipped).findings if "clipped" in f.what]


@pytest.mark.parametrize("full", [1.0, 100.0])
def test_a_throttle_that_goes_below_zero_brakes_there(full):
    pedals = CLEAN.data["pedals"][1]
    one = CLEAN.change("pedals", "throttle", lambda throttle: full * (throttle - pedals["brake"]))
    first = edited(rig(), [Edit("channels.brake", None), Edit("absent", [*rig().absent, "brake"])])
    found = inspect_log(one, first)
    assert Edit("channels.throttle.clip", [0.0, 1.0]) in found.cure
    cured = edited(first, found.cure)
    assert inspect_log(one, cured).cure == ()
    assert "brake" not in cured.absent
    both = pedals["throttle"] - pedals["brake"]
    for name, sign in (("throttle", 1), ("brake", -1)):
        read = read_channel(one, cured, name, cured.channels[name])[0].values[:, 0]
        np.testing.assert_allclose(read, np.maximum(sign * both, 0), atol=0.02)


@pytest.mark.parametrize("rest", [-1.0, 11.0, 1000.0])
def test_a_brake_that_nobody_pressed_rests_at_zero_and_has_no_scale(rest: float) -> None:
    log = drive_log(seconds=60, braking=0.0).change("pedals", "brake", lambda values: np.full(len(values), rest))
    found = inspect_log(log, rig())
    assert found.cure == (Edit("channels.brake.offset", -rest),)
    assert not severe(log, edited(rig(), found.cure))


DRIVE = drive_log()
FULL = drive_log(seconds=120, seed=3)
"""With the throttle pressed to 1 again and again."""


def _found(log: MemoryLog, *changes: tuple[str, str]) -> list[Finding]:
    return check_range_ends(drive_from_log(log, rig(*changes)))


CUTS = [("pedals", "throttle", "throttle", 0.4), ("steering", "command", "steer", 0.3)]


@pytest.mark.parametrize(("topic", "field", "name", "limit"), CUTS)
def test_a_control_that_is_cut_off_is_named_with_its_limit(topic: str, field: str, name: str, limit: float) -> None:
    log = DRIVE.change(topic, field, lambda values: np.clip(values, -limit, limit))
    (finding,) = _found(log)
    assert (finding.severity, finding.where) == ("warning", name)
    assert f"exactly {limit:g}" in finding.evidence
    assert not finding.cures  # whether it is a scale or a cut, the log does not say


def test_a_scale_is_offered_where_full_throttle_is_pressed_again_and_again() -> None:
    assert _found(FULL) == []
    (finding,) = _found(FULL.change("pedals", "throttle", lambda values: 0.25 * values))
    assert "channels.throttle.scale = 4.0" in finding.remedy


def test_who_presses_no_further_is_healthy() -> None:
    # The largest of a driver's presses comes once, whatever it is.
    gentle = DRIVE.change("pedals", "throttle", lambda values: 0.3 * np.sin(values))
    assert np.sum(gentle.data["pedals"][1]["throttle"] > 0.25) > 100
    assert _found(gentle) == []


def test_a_switch_is_no_limit() -> None:
    log = DRIVE.change("pedals", "brake", lambda values: np.where(values > 0.05, 0.6, 0.0))
    assert np.sum(np.diff(log.data["pedals"][1]["brake"]) > 0) > 5
    assert _found(log) == []


def test_no_control_of_a_recorded_drive_ends_short_of_its_range(data_folder: Path) -> None:
    recorded = [(path, "dart") for path in data_folder.glob("dart/**/*.csv")]
    recorded += [(path, "tartandrive2") for path in data_folder.glob("tartandrive2/drives/*")]
    assert len(recorded) == 15
    drives = [(path, drive_from_log(open_log(path), load_rig(name))) for path, name in recorded]
    assert [path.name for path, drive in drives if check_range_ends(drive)] == []


def presses(low: float, high: float, *, rest: float, share: float = 0.2) -> np.ndarray:
    """A pedal that rests at one value and is pressed to others for a share of the time, slowly."""
    t = np.linspace(0, 40, 2000)
    pressed = np.clip(np.sin(t) - 1 + 2 * share, 0, None) / (2 * share)
    away = high if rest == low else low
    return rest + (away - rest) * pressed


@pytest.mark.parametrize(
    ("low", "high", "rest", "whole"),
    [
        (0.0, 83.75, 0.0, (0.0, 100.0)),
        (0.0, 210.0, 0.0, (0.0, 255.0)),
        (0.0, 0.6, 0.0, (0.0, 1.0)),
        (-0.634, 1.0, 1.0, (-1.0, 1.0)),
        (-1.0, 0.3, -1.0, (-1.0, 1.0)),
        (-32767.0, 1000.0, -32767.0, (-32767.0, 32767.0)),
        (1500.0, 1900.0, 1500.0, None),
        (0.0, 0.3, 0.0, None),
        (-0.5, 0.5, 0.5, None),
    ],
)
def test_the_whole_range_is_that_of_usual_loggers(
    low: float, high: float, rest: float, whole: tuple[float, float] | None
) -> None:
    assert whole_range(presses(low, high, rest=rest)) == whole


def _rig(low: float, high: float) -> Rig:
    return rig(('fields = ["command"]', f'fields = ["command"]\nvalid = [{low}, {high}]'))


def _found_dropped(log: MemoryLog, of: Rig) -> list[Finding]:
    return check_dropped(read_topics(RememberedLog(log, of), of)[0], of)


@pytest.mark.parametrize("most", [0.3, 0.6])
def test_a_range_that_drops_measurements_is_widened_to_hold_all(most: float) -> None:
    (finding,) = _found_dropped(DRIVE, _rig(-most, most))
    assert (finding.severity, finding.where, finding.what) == ("warning", "steer", "valid drops measurements")
    values = DRIVE.data["steering"][1]["command"]
    assert f"{np.sum(np.abs(values) > most)} of {len(values)} samples" in finding.evidence
    cured = edited(_rig(-most, most), finding.cures[0])
    low, high = cured.channels["steer"].valid
    assert low < values.min() < values.max() < high
    assert _found_dropped(DRIVE, cured) == []


def test_faults_are_rightly_dropped() -> None:
    random = np.random.default_rng(0)

    def faulty(values: np.ndarray) -> np.ndarray:
        values[random.choice(len(values), 50, replace=False)] = 8.0
        values[300:400] = -5.0
        return values

    assert _found_dropped(DRIVE.change("steering", "command", faulty), _rig(-1.1, 1.1)) == []


@pytest.mark.parametrize(("field", "name", "limit"), [("command", "steer", 0.3), ("angle", "steer_angle", 0.1)])
def test_a_steering_that_is_cut_off_is_named_with_its_limit(field: str, name: str, limit: float) -> None:
    (finding,) = checked(
        check_saturation, DRIVE.change("steering", field, lambda values: np.clip(values, -limit, limit))
    )
    assert (finding.severity, finding.where) == ("warning", name)
    assert f"of its samples are {limit:g}" in finding.evidence


def test_full_lock_is_no_cut() -> None:
    """The wheels stop where the command does: the vehicle turns no further."""
    limit = 0.5
    _, columns = DRIVE.data["steering"]
    command = np.clip(columns["command"], -limit, limit)
    assert np.mean(np.abs(command) >= limit) > 0.02
    assert checked(check_saturation, steered(DRIVE, command, follows=0.0)) == []


@pytest.mark.parametrize(("largest", "found"), [(1.0, []), (0.7, ["steer"])])
def test_slow_wheels_turn_furthest_where_full_lock_is_held(largest: float, found: list[str]) -> None:
    """A command that ends at 1 has no more to give; one that ends below may be cut off."""
    random = np.random.default_rng(3)
    stamps, _ = DRIVE.data["steering"]
    held = np.repeat(random.choice([-1.0, 1.0], 200), 12)[: len(stamps) // 5]
    quick = 0.97 * np.sin(0.25 * np.arange(len(stamps) - len(held)))
    command = largest * np.concatenate((held, quick))
    assert [f.where for f in checked(check_saturation, steered(DRIVE, command, follows=0.15))] == found


def test_a_clean_log_is_not_cut_off() -> None:
    assert checked(check_saturation, DRIVE) == []


def _stepped(topic: str, fields: tuple[str, ...], step: float) -> MemoryLog:
    log = DRIVE
    for field in fields:
        log = log.change(topic, field, lambda values: np.round(values / step) * step)
    return log


@pytest.mark.parametrize(
    ("topic", "fields", "where", "step"),
    [
        ("odom", ("x", "y"), "position", 0.5),
        ("odom", ("vx", "vy", "vz"), "linear_velocity", 2.0),
        ("steering", ("command",), "steer", 0.3),
        ("steering", ("angle",), "steer_angle", 0.1),
    ],
)
def test_coarse_steps_are_named_with_their_size(topic: str, fields: tuple[str, ...], where: str, step: float) -> None:
    (finding,) = checked(check_resolution, _stepped(topic, fields, step))
    assert (finding.severity, finding.where, finding.what) == ("warning", where, "is recorded in coarse steps")
    assert f"{step:g}" in finding.evidence


@pytest.mark.parametrize(
    ("topic", "fields", "step"),
    [("odom", ("x", "y"), 0.01), ("odom", ("vx", "vy", "vz"), 0.01), ("steering", ("command",), 0.02)],
)
def test_fine_steps_do_no_harm(topic: str, fields: tuple[str, ...], step: float) -> None:
    assert checked(check_resolution, _stepped(topic, fields, step)) == []


def test_single_precision_far_from_the_origin_shows_in_one_axis_alone() -> None:
    """Northings in float32 have steps of 0.5 m, eastings of 0.03 m: the coarser decides."""
    log = DRIVE.change("odom", "x", lambda values: (412_000 + values).astype(np.float32).astype(float))
    log = log.change("odom", "y", lambda values: (5_312_000 + values).astype(np.float32).astype(float))
    (finding,) = checked(check_resolution, log)
    assert finding.where == "position"
    assert "multiples of 0.5" in finding.evidence


def test_a_clean_log_and_a_channel_that_never_changes_have_no_steps() -> None:
    assert checked(check_resolution, DRIVE) == []
    assert checked(check_resolution, DRIVE.change("steering", "command", np.zeros_like)) == []
