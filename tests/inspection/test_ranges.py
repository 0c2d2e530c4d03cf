"""Ranges of controls: units, scales, wrapping counters, cut-off values, coarse steps and dropped samples."""

from pathlib import Path

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, severe

from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.limits import check_range_ends
from offpiste.logs import open_log
from offpiste.logs.channel import read_channel
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import load_rig

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


FULL = drive_log(seconds=120, seed=3)
"""With the throttle pressed to 1 again and again."""


def _found(log: MemoryLog, *changes: tuple[str, str]) -> list[Finding]:
    return check_range_ends(drive_from_log(log, rig(*changes)))


def test_a_scale_is_offered_where_full_throttle_is_pressed_again_and_again() -> None:
    assert _found(FULL) == []
    (finding,) = _found(FULL.change("pedals", "throttle", lambda values: 0.25 * values))
    assert "channels.throttle.scale = 4.0" in finding.remedy


def test_no_control_of_a_recorded_drive_ends_short_of_its_range(data_folder: Path) -> None:
    recorded = [(path, "dart") for path in data_folder.glob("dart/**/*.csv")]
    recorded += [(path, "tartandrive2") for path in data_folder.glob("tartandrive2/drives/*")]
    assert len(recorded) == 15
    drives = [(path, drive_from_log(open_log(path), load_rig(name))) for path, name in recorded]
    assert [path.name for path, drive in drives if check_range_ends(drive)] == []
