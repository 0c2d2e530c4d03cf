"""What passes the gate: never more, and never faster, than the limits; a stop where something speaks against more."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offpiste.core.conventions import DT
from offpiste.live.gate import Gate
from offpiste.rig.outputs import CommandLimits, Enable

LIMITS = CommandLimits(throttle=0.6, steer=0.8, throttle_rate=2.0, brake_rate=5.0, steer_rate=3.0, speed=5.0)
FULL = np.array((1.0, 0.0, 1.0))


def settled(gate, control, now=0.0, speed=1.0, stopping=False, steps=100):
    return [gate.passed(control, speed, now, stopping=stopping) for _ in range(steps)]


@given(st.lists(st.tuples(*(st.floats(-2, 2),) * 3, st.booleans()), min_size=2, max_size=30))
def test_commands_stay_within_their_limits_and_rates(commands):
    gate = Gate(LIMITS, None, 0.5)
    sent = [gate.passed(np.array(c[:3]), 1.0, 0.0, stopping=c[3]).control for c in commands]
    change = np.diff(sent, axis=0)
    assert (np.array(sent)[:, 0] <= 0.6).all()
    assert (np.abs(np.array(sent)[:, 2]) <= 0.8).all()
    assert (change[:, 0] <= 2.0 * DT + 1e-9).all(), "throttle rises no faster"
    assert (np.abs(change[:, 2]) <= 3.0 * DT + 1e-9).all()
    for step, command in zip(change[:, 1], commands[1:], strict=True):
        assert command[3] or abs(step) <= 5.0 * DT + 1e-9, "but for a stop"


def test_throttle_is_released_and_a_stop_is_applied_at_once():
    gate = Gate(LIMITS, None, 0.5)
    assert settled(gate, FULL)[-1].control.tolist() == [0.6, 0.0, 0.8]
    stopped = gate.passed(np.array((0.0, 0.9, 1.0)), 1.0, 0.0, stopping=True)
    assert stopped.control.tolist() == [0.0, 0.9, 0.8]
    assert stopped.why == ""


def test_above_the_largest_speed_the_throttle_is_released():
    gate = Gate(LIMITS, None, 0.5)
    settled(gate, FULL)
    assert gate.passed(FULL, 5.1, 0.0, stopping=False).control[0] == 0.0


@pytest.mark.parametrize("limits", [LIMITS, CommandLimits()])
def test_at_an_unknown_speed_the_throttle_is_released_whatever_the_limits(limits):
    for speed in (np.inf, np.nan):
        gate = Gate(limits, None, 0.5)
        settled(gate, FULL)
        assert gate.passed(FULL, speed, 0.0, stopping=False).control[0] == 0.0


def test_the_dead_mans_switch_has_to_be_heard_and_pressed():
    gate = Gate(LIMITS, Enable("/enable", timeout=0.3), 0.5)
    assert settled(gate, FULL)[-1].why == "the enable topic is not heard"
    gate.enabled(False, 1.0)
    assert gate.blocked(1.1) == "not enabled"
    gate.enabled(True, 2.0)
    assert gate.blocked(2.29) == ""
    passed = settled(gate, FULL, now=2.2)[-1]
    assert passed.control.tolist() == [0.6, 0.0, 0.8]
    lost = gate.passed(FULL, 1.0, 2.31, stopping=False)
    assert lost.why == "the enable topic is not heard"
    assert lost.control[:2].tolist() == [0.0, 0.5]


def test_a_switch_that_another_thread_heard_a_moment_later_is_heard():
    gate = Gate(LIMITS, Enable("/enable", timeout=0.3), 0.5)
    gate.enabled(True, 1.0)
    assert gate.blocked(0.999) == ""
    gate.restart(0.5)
    assert gate.blocked(0.5) == "the enable topic is not heard", "it is of another time"


def test_a_switch_counts_from_its_stamp():
    gate = Gate(LIMITS, Enable("/enable", timeout=0.3), 0.5)
    gate.enabled(True, 1.0, age=0.2)
    assert gate.blocked(1.09) == ""
    assert gate.blocked(1.11) == "the enable topic is not heard"
    gate.enabled(True, 2.0, age=-0.2)
    assert gate.blocked(2.29) == "", "a clock that is a little ahead"
    gate.enabled(False, 3.0, age=0.1)
    gate.enabled(True, 3.01, age=0.2)
    assert gate.blocked(3.02) == "not enabled", "it was pressed before it was released"
    gate.enabled(False, 3.03, age=0.3)
    gate.enabled(True, 3.04)
    assert gate.blocked(3.04) == ""
    gate.enabled(False, 3.05, age=5.0)
    assert gate.blocked(3.05), "released, whatever its stamp"


@pytest.mark.parametrize(
    ("age", "why"),
    [
        (0.31, "stamped more than 0.3 s ago"),
        (-0.31, "in the future"),
        (np.nan, "no valid stamp"),
        (-np.inf, "no valid"),
    ],
)
def test_a_switch_with_a_wrong_stamp_does_not_count(age, why):
    gate = Gate(LIMITS, Enable("/enable", timeout=0.3), 0.5)
    gate.enabled(True, 0.9)
    assert gate.blocked(1.0) == ""
    for now in (1.0, 1.1, 1.3):
        gate.enabled(True, now, age=age)
    assert why in gate.blocked(1.31)
    assert gate.passed(FULL, 1.0, 1.31, stopping=False).control[0] == 0


def test_a_second_publisher_of_the_switch_is_a_stop():
    gate = Gate(LIMITS, Enable("/enable", timeout=0.3), 0.5)
    for tenth in range(19):
        gate.enabled(True, tenth / 10, publisher=b"one")
        if tenth == 9:
            assert gate.blocked(0.9) == ""
            gate.enabled(True, 0.91, publisher=b"other")
    assert gate.blocked(1.85) == "more than one publisher of the enable topic"
    gate.enabled(True, 2.0, publisher=b"one")
    assert gate.blocked(2.01) == ""
    gate.enabled(True, 3.1, publisher=b"one, started again")
    assert gate.blocked(3.11) == "", "after a second of silence"


def test_a_switch_without_its_field_is_named():
    gate = Gate(LIMITS, Enable("/enable", field="value", timeout=0.3), 0.5)
    gate.enabled(None, 1.0)
    assert gate.blocked(1.1) == "the messages of the enable topic have no number 'value'"


def test_while_another_commands_the_vehicle_is_stopped():
    gate = Gate(LIMITS, None, 0.5)
    settled(gate, FULL)
    gate.other(10.0)
    assert gate.passed(FULL, 1.0, 10.9, stopping=False).why == "another publisher commands the vehicle"
    assert gate.passed(FULL, 1.0, 11.1, stopping=False).why == ""


@pytest.mark.parametrize("place", [0, 1, 2])
def test_what_is_not_finite_is_a_stop(place):
    gate, command = Gate(LIMITS, None, 0.5), np.array((0.5, 0.0, 0.4))
    settled(gate, command)
    command[place] = np.nan
    passed = gate.passed(command, 1.0, 0.0, stopping=False)
    assert passed.why == "the command is not finite"
    assert passed.control.tolist() == [0.0, 0.5, pytest.approx(0.4)]
