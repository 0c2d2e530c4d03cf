"""Columns `control` and `actuators`: what was commanded, and what the vehicle made of it."""

import numpy as np

from offpiste.conventions import ACTUATORS, CONTROL
from offpiste.dataset.columns import COLUMNS, Column
from offpiste.rig.rig import ACTUATOR_CHANNELS, CONTROL_CHANNELS, Rig


def present_control(rig: Rig) -> tuple[str, ...]:
    """Names of `conventions.CONTROL` that a rig's logs have."""
    return tuple(name for name, channel in zip(CONTROL, CONTROL_CHANNELS, strict=True) if channel in rig.channels)


def present_actuators(rig: Rig) -> tuple[str, ...]:
    """Names of `conventions.ACTUATORS` that a rig's logs have; a steering rate can be derived from the angle."""
    have = set(rig.channels) | ({"steer_rate"} if "steer_angle" in rig.channels else set())
    return tuple(name for name, channel in zip(ACTUATORS, ACTUATOR_CHANNELS, strict=True) if channel in have)


COLUMNS.register("control")(
    Column(
        read=lambda grid: np.column_stack([grid.channel(name) for name in CONTROL_CHANNELS]),
        shape=(len(CONTROL),),
        present=lambda rig: [name in present_control(rig) for name in CONTROL],
        segments=("past", "ahead"),
    )
)
COLUMNS.register("actuators")(
    Column(
        read=lambda grid: np.column_stack([grid.channel(name) for name in ACTUATOR_CHANNELS]),
        shape=(len(ACTUATORS),),
        present=lambda rig: [name in present_actuators(rig) for name in ACTUATORS],
        segments=("past", "start", "target"),
    )
)
