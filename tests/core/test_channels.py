"""The tables of controls and actuators, and what is derived from them."""

import re

import pytest

from offpiste.core.channels import (
    ACTUATORS,
    CONTROLS,
    KERNEL_CONTROLS,
    MORE_CONTROLS,
    actuator_columns,
    all_actuators,
    all_controls,
    channel_of_rate,
    control_columns,
    control_of,
)
from offpiste.dynamics import Vehicle
from offpiste.dynamics.actuator_lags import LAGS, lagging
from offpiste.dynamics.inputs import DriveTrain
from offpiste.rig.channels import known_channels, unit_factor


def test_names_are_unique_and_refer_to_each_other() -> None:
    controls, actuators = all_controls(), all_actuators()
    for names in ([c.name for c in controls], [a.name for a in actuators], [a.channel for a in actuators]):
        assert len(set(names)) == len(names)
    for actuator in actuators:
        if actuator.rate_of:
            assert actuator.rate_of in [a.name for a in actuators]
        else:
            assert actuator.follows in [c.name for c in controls]
            assert actuator.lag in LAGS
        assert actuator.drives in ("", *DriveTrain._fields)


def test_every_dataset_has_the_tables_columns() -> None:
    assert control_columns(()) == CONTROLS
    assert actuator_columns(["brake"]) == ACTUATORS
    assert control_columns(["gear", "brake"]) == KERNEL_CONTROLS
    vehicle = Vehicle(900.0, 2.0, 0.4, ("steer",), ())
    assert vehicle.control_columns == ("throttle", "brake", "steer")
    assert vehicle.actuator_columns == ("brake", "steer", "steer_rate", "engine_rpm")


def test_optional_controls_are_columns_of_rigs_that_give_them_only() -> None:
    assert [control.name for control in KERNEL_CONTROLS] == ["throttle", "brake", "steer", "gear"]
    assert not any(control.declared for control in all_controls() if control not in CONTROLS)
    geared = Vehicle(900.0, 2.0, 0.4, ("steer", "gear"), ())
    assert geared.control_columns == ("throttle", "brake", "steer", "gear")
    assert not {control.name for control in KERNEL_CONTROLS} & {name for name, _ in MORE_CONTROLS.items()}


def test_a_second_order_lag_has_its_rate_beside_it() -> None:
    columns = {one.label: one.columns for one in lagging()}
    assert columns == {"brake": ("brake",), "steer": ("steer", "steer_rate"), "engine": ("engine_rpm",)}
    with pytest.raises(ValueError, match="steer needs its rate"):
        Vehicle(900.0, 2.0, 0.4, ("steer",), ("steer",))


def test_a_rate_comes_from_the_channel_that_it_is_the_rate_of() -> None:
    assert channel_of_rate("steer_rate") == "steer_angle"
    assert channel_of_rate("brake_pressure") == ""


def test_rigs_know_all_channels_and_their_units() -> None:
    assert {"position", "brake", "brake_pressure", "engine_rpm"} <= set(known_channels())
    assert unit_factor("engine_rpm", "rev/min") == pytest.approx(0.001)


@pytest.mark.parametrize(
    "name", ["throttle", "acc_pedal", "accel_pedal", "accelerator", "accelerator_pedal", "gas", "thr"]
)
def test_pedals_are_known_by_name(name: str) -> None:
    control = control_of("throttle")
    assert control is not None
    assert re.search(control.pattern, name)


@pytest.mark.parametrize("name", ["acceleration", "accelerometer", "through", "brake_pedal", "thrust"])
def test_other_names_are_no_pedal(name: str) -> None:
    control = control_of("throttle")
    assert control is not None
    assert not re.search(control.pattern, name)
