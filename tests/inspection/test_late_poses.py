"""Poses that are late, against sensors that are early: which of them is stamped wrong."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.lags import LAGS, LagFit
from offpiste.inspection.late_poses import Interval, _behind_the_course, _far_behind, _intervals
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

FIELDS = {
    "orientation": ("qx", "qy", "qz", "qw"),
    "angular_velocity": ("wx", "wy", "wz"),
    "position": ("x", "y", "z", "qx", "qy", "qz", "qw"),
    "linear_velocity": ("vx", "vy", "vz"),
}


def _late(channel: str, by: float) -> MemoryLog:
    """The drive of a vehicle that turns 0.15 s after its steering, with some columns stamped late."""
    log = drive_log(seed=0)
    time, command = log.data["steering"]
    log = MemoryLog({**log.data, "steering": (time - 0.15, command)})
    time = log.data["odom"][0]
    for field in FIELDS[channel]:
        log = log.change("odom", field, lambda values: np.interp(time - by, time, values))
    return log


@pytest.mark.parametrize("channel", FIELDS)
@pytest.mark.parametrize("by", [-0.2, 0.2, 0.4])
def test_what_is_late_is_what_most_else_differs_from(channel: str, by: float) -> None:
    first = inspect_log(_late(channel, by), rig()).findings[0]
    assert (first.where, first.what) == (channel, "is late" if by > 0 else "is early")
    cured = {edit.key: edit.value for edit in first.cures[0]}
    together = ("position", "orientation") if channel == "position" else (channel,)
    assert set(cured) == {f"channels.{name}.delay" for name in together}
    assert all(value == pytest.approx(by, abs=0.06) for value in cured.values())


@pytest.mark.parametrize("late", [-0.8, 0.6, 1.0])
def test_a_heading_that_is_late_by_much_is_known_by_its_turning(late: float) -> None:
    """Its angle to the course is then any."""
    far = _far_behind(driven_path(drive_from_log(_late("orientation", late), rig())))
    assert far is not None
    assert far[0] == pytest.approx(late, abs=0.05)


@pytest.mark.parametrize("late", [0.0, 0.2])
def test_no_other_heading_is_late_by_much(late: float) -> None:
    assert _far_behind(driven_path(drive_from_log(_late("orientation", late), rig()))) is None


def test_stamps_that_agree_raise_nothing() -> None:
    assert [f for f in inspect_log(_late("position", 0.0), rig()).findings if f.severity == "warning"] == []


@pytest.mark.parametrize(("sign", "lags"), [(1, [0.1]), (-1, [])])
def test_a_driver_who_lets_go_before_a_bend_makes_no_pose_late(sign: int, lags: list[float]) -> None:
    """What follows an open throttle goes faster; what comes before it and goes slower is another reason."""
    drive = drive_from_log(_late("position", 0.0), rig())
    r = sign * np.exp(-((LAGS - 0.1 * sign) ** 2)) * 0.6
    fit = LagFit(LAGS, r, r, 1000, np.stack([r, r]), np.stack([r, r]))
    behind = [one for one in _intervals(drive, driven_path(drive), {}, {"throttle": fit}) if one.other == "throttle"]
    assert [one.time for one in behind] == pytest.approx(lags)


@pytest.mark.parametrize("late", [(), ("orientation",), ("position", "orientation")])
def test_an_interval_costs_what_it_differs_from_the_usual_if_its_ends_are_moved(late: tuple[str, ...]) -> None:
    interval = Interval("orientation", "position", time=0.3, usual=-0.1, spread=0.2)
    moved = 0.5 if late == ("orientation",) else 0.0
    assert interval.cost(frozenset(late), np.array([0.5]))[0] == pytest.approx(((0.4 - moved) / 0.2) ** 2)


@pytest.mark.parametrize(("answer", "found"), [(0.35, []), (-0.3, ["position"])])
def test_a_vehicle_that_answers_slowly_is_not_late(answer: float, found: list[str]) -> None:
    """Both its pedals and its steering seem early then, as of a pose that is late; none of them answers before."""
    log = _late("position", 0.0)
    for topic in ("pedals", "steering"):
        time, columns = log.data[topic]
        log = MemoryLog({**log.data, topic: (time - answer, columns)})
    late = [f.where for f in inspect_log(log, rig()).findings if f.what in ("is late", "is early")]
    assert late == found


def test_controls_that_are_late_are_not_a_pose_that_is_early_where_the_wheels_roll_with_it() -> None:
    log = _late("position", 0.0)
    for topic in ("pedals", "steering"):
        log = log.restamp(topic, lambda time: time + 0.4)
    wheels = {"topic": "wheels", "fields": ["rear"], "scale": 0.04}
    findings = inspect_log(log, edited(rig(), [Edit("channels.wheel_speed", wheels)])).findings
    assert "position" not in {f.where for f in findings if f.severity == "warning"}
    cures = {edit.key: edit.value for f in findings for cure in f.cures[:1] for edit in cure}
    assert {"channels.throttle.delay", "channels.steer.delay"} <= set(cures)
    assert all(0.25 < value < 0.55 for key, value in cures.items() if key.endswith(".delay"))


def test_no_tyre_slips_against_a_heading_that_is_the_course() -> None:
    """As a GPS says it: at 40 m/s a heading of its own would be ahead by almost a second."""
    path = driven_path(drive_from_log(_late("position", 0.0), rig()))
    fast = {name: 4 * getattr(path, name) for name in ("place", "velocity", "speed", "forward", "acceleration")}
    assert 4 * path.cruise > 30
    (behind,) = _behind_the_course("yaw", replace(path, **fast))
    assert behind.time - behind.usual == pytest.approx(0.0, abs=0.05)
    assert behind.spread < 0.1
