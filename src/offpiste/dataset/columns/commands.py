"""Columns `control` and `actuators`: what was commanded, and what the vehicle made of it."""

import numpy as np

from offpiste.conventions import ACTUATORS, CONTROL
from offpiste.dataset.columns import COLUMNS, Column

COLUMNS.register("control")(
    Column(
        read=lambda grid: np.column_stack([grid.channel(control.name) for control in grid.drive.rig.controls]),
        shape=(len(CONTROL),),
        present=lambda rig: [control.name in rig.present_controls for control in rig.controls],
        segments=("past", "ahead"),
    )
)
COLUMNS.register("actuators")(
    Column(
        read=lambda grid: np.column_stack([grid.channel(actuator.channel) for actuator in grid.drive.rig.actuators]),
        shape=(len(ACTUATORS),),
        present=lambda rig: [actuator.name in rig.present_actuators for actuator in rig.actuators],
        segments=("past", "start", "target"),
    )
)
