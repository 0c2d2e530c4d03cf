"""The gate: limits and rates always hold, and every doubt is a stop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offpiste.core.conventions import DT
from offpiste.live.gate import Gate
from offpiste.rig.outputs import CommandLimits, Enable

LIMITS = CommandLimits(throttle=0.6, steer=0.8, throttle_rate=2.0, brake_rate=5.0, steer_rate=3.0, speed=5.0)
FULL = np.array((1.0, 0.0, 1.0))


def settled(limits=LIMITS, enable=None, control=FULL):
    """A gate to which a command was given for two seconds."""
    gate = Gate(limits, enable, 0.5)
    if enable is not None:
        gate.enabled(True, 0.0)
    for _ in range(100):
        gate.check(control, 1.0, 0.0, stopping=False)
    return gate


def switched():
    return Gate(LIMITS, Enable("/enable", field="value", timeout=0.3), 0.5)


@given(st.lists(st.tuples(*(st.floats(-2, 2),) * 3, st.booleans()), min_size=2, max_size=30))
def test_commands_stay_within_their_limits_and_rates(commands):
    gate = Gate(LIMITS, None, 0.5)
    sent = [gate.check(np.array(c[:3]), 1.0, 0.0, stopping=c[3]).control for c in commands]
    change = np.diff(sent, axis=0)
    assert (np.array(sent)[:, 0] <= 0.6).all()
    assert (np.abs(np.array(sent)[:, 2]) <= 0.8).all()
    assert (change[:, 0] <= 2.0 * DT + 1e-9).all(), "throttle rises no faster"
    assert (np.abs(change[:, 2]) <= 3.0 * DT + 1e-9).all()
    for step, command in zip(change[:, 1], commands[1:], strict=True):
        assert command[3] or abs(step) <= 5.0 * DT + 1e-9, "except for a stop"


def test_a_stop_is_applied_at_once():
    stopped = settled().check(np.array((0.0, 0.9, 1.0)), 1.0, 0.0, stopping=True)
    assert stopped.control.tolist() == [0.0, 0.9, 0.8]
    assert stopped.why == ""


@pytest.mark.parametrize(("limits", "speed"), [(LIMITS, 5.1), (LIMITS, np.nan), (CommandLimits(), np.inf)])
def test_above_the_maximum_or_at_an_unknown_speed_the_throttle_is_released(limits, speed):
    assert settled(limits).check(FULL, speed, 0.0, stopping=False).control[0] == 0.0


def test_the_switch_must_be_heard_and_pressed():
    gate = switched()
    assert gate.check(FULL, 1.0, 0.0, stopping=False).why == "the enable topic is not heard"
    gate.enabled(None, 0.5)
    assert gate.blocked(0.6) == "the messages of the enable topic have no number 'value'"
    gate.enabled(False, 1.0)
    assert gate.blocked(1.1) == "not enabled"
    gate.enabled(True, 2.0)
    assert gate.blocked(1.999) == "", "another thread may hear it slightly later"
    assert gate.check(FULL, 1.0, 2.29, stopping=False).control[0] > 0
    lost = gate.check(FULL, 1.0, 2.31, stopping=False)
    assert lost.why == "the enable topic is not heard"
    assert lost.control[:2].tolist() == [0.0, 0.5]


def test_a_switch_counts_from_its_stamp():
    gate = switched()
    gate.enabled(True, 1.0, age=0.2)
    assert gate.blocked(1.09) == ""
    assert gate.blocked(1.11) == "the enable topic is not heard"
    gate.enabled(True, 2.0, age=-0.2)
    assert gate.blocked(2.29) == "", "a clock slightly ahead"
    gate.enabled(False, 3.0, age=0.1)
    gate.enabled(True, 3.01, age=0.2)
    assert gate.blocked(3.02) == "not enabled", "it was pressed before it was released"
    gate.enabled(False, 3.03, age=0.3)
    gate.enabled(True, 3.04)
    assert gate.blocked(3.04) == ""
    gate.enabled(False, 3.05, age=5.0)
    assert gate.blocked(3.05), "released, whatever its stamp"


@pytest.mark.parametrize(
    ("age", "why"), [(0.31, "more than 0.3 s ago"), (-0.31, "in the future"), (np.nan, "no valid"), (-np.inf, "valid")]
)
def test_a_switch_with_a_wrong_stamp_does_not_count(age, why):
    gate = switched()
    gate.enabled(True, 0.9)
    assert gate.blocked(1.0) == ""
    for now in (1.0, 1.1, 1.3):
        gate.enabled(True, now, age=age)
    assert why in gate.check(FULL, 1.0, 1.31, stopping=False).why


def test_a_second_publisher_of_the_switch_is_a_stop():
    gate = switched()
    for tenth in range(19):
        gate.enabled(True, tenth / 10, publisher=b"one")
        if tenth == 9:
            assert gate.blocked(0.9) == ""
            gate.enabled(True, 0.91, publisher=b"other")
    assert gate.blocked(1.85) == "more than one publisher of the enable topic"
    gate.enabled(True, 2.0, publisher=b"one")
    assert gate.blocked(2.01) == ""
    gate.enabled(True, 3.1, publisher=b"one, restarted")
    assert gate.blocked(3.11) == "", "after a second of silence"


def test_commands_of_another_publisher_are_a_stop():
    gate = settled()
    gate.other(10.0)
    assert gate.check(FULL, 1.0, 10.9, stopping=False).why == "another publisher commands the vehicle"
    assert gate.check(FULL, 1.0, 11.1, stopping=False).why == ""


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_command_that_is_not_finite_is_a_stop(place):
    command = np.array((0.5, 0.0, 0.4))
    gate = settled(control=command)
    command[place] = np.nan
    passed = gate.check(command, 1.0, 0.0, stopping=False)
    assert passed.why == "the command is not finite"
    assert passed.control.tolist() == [0.0, 0.5, pytest.approx(0.4)]
