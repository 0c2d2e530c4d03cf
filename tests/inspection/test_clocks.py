"""Clocks that the speed of the wheels shows to be late, and what only looks like it."""

from collections.abc import Callable

import numpy as np
import pytest
from jaxtyping import Float
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.clocks import check_clocks
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import RememberedLog, read_topics
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig

CLEAN = drive_log(seconds=60)


def findings_with_a_throttle(ahead: float, of: Rig) -> list[Finding]:
    """Findings where the throttle is a share of the speed that the vehicle has so long after it [s]."""
    time, odom = CLEAN.data["odom"]
    pedals, _ = CLEAN.data["pedals"]
    speed = np.interp(pedals + ahead, time, odom["vx"]) / odom["vx"].max()
    log = CLEAN.change("pedals", "throttle", lambda _: speed)
    recorded, _ = read_topics(RememberedLog(log), of)
    return check_clocks(recorded, driven_path(drive_from_log(log, of)), of, besides={"odom"})


@pytest.mark.parametrize("fields", [["throttle"], ["brake"]])
def test_a_speed_that_follows_a_command_is_no_clock(fields: list[str]) -> None:
    """An electric car goes as fast as its throttle says, 0.6 s later; so does a robot whose speed is commanded, whether
    a channel reads that or not."""
    assert findings_with_a_throttle(0.6, edited(rig(), [Edit("channels.throttle.fields", fields)])) == []


def test_a_speed_that_is_asked_for_beside_the_pedals_is_no_clock() -> None:
    """Also on a topic that nothing reads, whose messages come with those of the pedals."""
    time, odom = CLEAN.data["odom"]
    pedals, _ = CLEAN.data["pedals"]
    asked = {"speed": np.interp(pedals + 0.6, time, odom["vx"])}
    log = MemoryLog({**CLEAN.data, "request": (pedals, asked)})
    recorded, _ = read_topics(RememberedLog(log), rig())
    assert check_clocks(recorded, driven_path(drive_from_log(log, rig())), rig(), besides={"odom"}) == []


def test_a_speed_that_comes_late_beside_commands_is_by_a_late_clock() -> None:
    (found,) = findings_with_a_throttle(-0.6, edited(rig(), [Edit("channels.throttle.fields", ["brake"])]))
    assert found.what == "is late"
    assert found.cures == ((Edit("channels.throttle.delay", 0.6), Edit("channels.brake.delay", 0.6)),)


@pytest.mark.parametrize(("late", "drifts"), [(-0.5, False), (0.5, True)])
def test_wheels_that_run_ahead_slip_and_those_that_come_late_have_a_clock_that_drifts(
    late: float, drifts: bool
) -> None:
    time, odom = CLEAN.data["odom"]
    stamps, columns = CLEAN.data["steering"]
    lag = late * (0.5 - 0.5 * np.cos(2 * np.pi * (stamps - stamps[0]) / 30))
    log = MemoryLog(
        {**CLEAN.data, "steering": (stamps, columns | {"wheels": np.interp(stamps - lag, time, odom["vx"])})}
    )
    recorded, _ = read_topics(RememberedLog(log), rig())
    found = check_clocks(recorded, driven_path(drive_from_log(log, rig())), rig(), besides={"odom"})
    assert [finding.what for finding in found] == (["has a clock that drifts"] if drifts else [])


@pytest.mark.parametrize(
    ("late", "what"),
    [
        (lambda t: -0.8 * np.sin(t / 5) ** 2, None),
        (lambda t: 0.4 * np.sin(t / 5), None),
        (lambda t: 0.8 * np.sin(t / 5) ** 2, "drifts"),
        (0.5, "is late"),
    ],
)
def test_what_has_the_stamps_of_the_pose_is_not_late_with_it(
    late: float | Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]], what: str | None
) -> None:
    """However far wheels run ahead, their clock is that of the pose; where they are late, the pose is not."""
    time, odom = CLEAN.data["odom"]
    lag = late(time) if callable(late) else late
    log = MemoryLog({**CLEAN.data, "wheels": (time, {"speed": np.interp(time - lag, time, odom["vx"])})})
    of = edited(rig(), [Edit("channels.wheel_speed", {"topic": "wheels", "fields": ["speed"]})])
    recorded, _ = read_topics(RememberedLog(log), of)
    found = check_clocks(recorded, driven_path(drive_from_log(log, of)), of, besides={"odom"})
    assert [finding.where for finding in found] == ([] if what is None else ["wheels"])
    assert all(what in finding.what for finding in found)
    cured = {edit.key for finding in found for cure in finding.cures for edit in cure}
    assert cured <= {"alignment", "channels.wheel_speed.delay"}
