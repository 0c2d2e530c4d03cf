"""Tables of controls and actuators."""

import re

import pytest

from offpiste.core.channels import (
    ACTUATORS,
    CONTROLS,
    KERNEL_CONTROLS,
    actuator_columns,
    channel_of_rate,
    control_columns,
    control_of,
)
from offpiste.dynamics import Vehicle
from offpiste.dynamics.actuator_lags import lagging


def test_columns_are_those_of_every_dataset_and_optional_ones_of_the_rig() -> None:
    assert control_columns(()) == CONTROLS
    assert actuator_columns(["brake"]) == ACTUATORS
    assert control_columns(["gear", "brake"]) == KERNEL_CONTROLS
    assert Vehicle(900.0, 2.0, 0.4, ("steer",), ()).control_columns == ("throttle", "brake", "steer")
    assert Vehicle(900.0, 2.0, 0.4, ("steer", "gear"), ()).control_columns == ("throttle", "brake", "steer", "gear")


def test_a_second_order_lag_needs_its_rate() -> None:
    columns = {one.label: one.columns for one in lagging()}
    assert columns == {"brake": ("brake",), "steer": ("steer", "steer_rate"), "engine": ("engine_rpm",)}
    with pytest.raises(ValueError, match="steer needs its rate"):
        Vehicle(900.0, 2.0, 0.4, ("steer",), ("steer",))
    assert channel_of_rate("steer_rate") == "steer_angle"
    assert channel_of_rate("brake_pressure") == ""


def test_pedals_are_recognised_by_name() -> None:
    control = control_of("throttle")
    assert control is not None
    pedals = ("throttle", "acc_pedal", "accel_pedal", "accelerator", "accelerator_pedal", "gas", "thr")
    others = ("acceleration", "accelerometer", "through", "brake_pedal", "thrust")
    assert [name for name in (*pedals, *others) if re.search(control.pattern, name)] == [*pedals]
