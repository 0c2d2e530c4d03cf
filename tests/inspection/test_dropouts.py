"""Falls to one value and back: found where a channel else changes steadily."""

import numpy as np
import pytest
from scipy.signal import lfilter
from simulated import START, MemoryLog, drive_log, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.dropouts import check_dropouts
from offpiste.inspection.findings import Finding
from offpiste.logs.drive import drive_from_log

CLEAN = drive_log(seed=0)
for _field in ("command", "angle"):  # a wheel that is turned slowly
    CLEAN = CLEAN.change("steering", _field, lambda values: 0.9 * np.sin(0.1 + np.arange(len(values)) / 40))


def _found(log: MemoryLog) -> list[Finding]:
    drive = drive_from_log(log, rig())
    return check_dropouts(drive, driven_path(drive))


def _fallen(topic: str, field: str, count: int) -> MemoryLog:
    """The log with a field at zero for a while, from where it is largest on."""
    first = int(np.abs(CLEAN.data[topic][1][field]).argmax()) - count // 2

    def fall(values: np.ndarray) -> np.ndarray:
        values[first : first + count] = 0.0
        return values

    return CLEAN.change(topic, field, fall)


@pytest.mark.parametrize(
    ("topic", "field", "name"),
    [("steering", "command", "steer"), ("steering", "angle", "steer_angle"), ("odom", "vx", "linear_velocity")],
)
def test_a_fall_is_named_with_its_time(topic: str, field: str, name: str) -> None:
    log = _fallen(topic, field, 8)
    if field == "vx":  # all components fall at once
        held = log.data[topic][1]["vx"] == 0
        log = log.change(topic, "vy", lambda v: np.where(held, 0.0, v)).change(
            topic, "vz", lambda v: np.where(held, 0.0, v)
        )
    (finding,) = _found(log)
    time, columns = log.data[topic]
    since = time[np.flatnonzero(columns[field] == 0)[0]] - time[0]
    assert (finding.severity, finding.where) == ("warning", name)
    assert f"from {since:.2f} s on" in finding.evidence


@pytest.mark.parametrize("times", [1, 2])
def test_a_wheel_is_turned_as_far_as_it_goes_once_but_not_twice(times: int) -> None:
    def turned(values: np.ndarray) -> np.ndarray:
        for one in range(times):
            values[1000 + 500 * one :][:10] = -np.sign(values[1000 + 500 * one])
        return values

    assert len(_found(CLEAN.change("steering", "command", turned))) == times - 1


def test_a_wheel_that_the_vehicle_follows_was_turned() -> None:
    """A driver who steers against a rollover again and again, as the yaw rate shows; a lost value moves nothing."""
    time = np.arange(3000) / 50
    driven = 0.3 * np.sin(time / 2)
    turned = driven.copy()
    for first in (700, 1300, 2100):
        turned[first : first + 35] = -0.5
    for moved, found in ((turned, []), (driven, ["steer", "steer_angle"])):
        angle = lfilter([0.2], [1, -0.8], moved)
        yaw = np.cumsum(4 * np.tan(angle) / 2) / 50
        columns = {"x": np.cumsum(4 * np.cos(yaw)) / 50, "y": np.cumsum(4 * np.sin(yaw)) / 50, "z": 0 * yaw}
        columns |= {"qx": 0 * yaw, "qy": 0 * yaw, "qz": np.sin(yaw / 2), "qw": np.cos(yaw / 2)}
        columns |= {"vx": 0 * yaw + 4, "vy": 0 * yaw, "vz": 0 * yaw, "wx": 0 * yaw, "wy": 0 * yaw, "wz": 0 * yaw}
        steering = {"command": 2 * turned, "angle": turned}
        log = MemoryLog({**CLEAN.data, "odom": (START + time, columns), "steering": (START + time, steering)})
        assert [finding.where for finding in _found(log)] == found


def test_a_wheel_that_is_turned_at_once_again_and_again_is_driven_so() -> None:
    random = np.random.default_rng(0)

    def switched(values: np.ndarray) -> np.ndarray:
        return np.repeat(random.uniform(-1, 1, len(values) // 25 + 1), 25)[: len(values)]

    assert _found(CLEAN.change("steering", "command", switched)) == []


def test_pedals_are_let_go_in_an_instant_and_clean_logs_do_not_fall() -> None:
    assert _found(_fallen("pedals", "throttle", 30)) == []
    assert _found(CLEAN) == []
