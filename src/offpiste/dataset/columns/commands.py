"""Columns of what was commanded and what the vehicle made of it: as it happened, and as it was known at the time."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from offpiste.conventions import ACTUATORS, CONTROL
from offpiste.dataset.columns import COLUMNS, Column, RowGrid
from offpiste.rig.rig import Rig

ReadChannels = Callable[[RowGrid], Float[np.ndarray, "N k"]]


def _controls(channel: Callable[[RowGrid, str], np.ndarray]) -> ReadChannels:
    return lambda grid: np.column_stack([channel(grid, control.name) for control in grid.drive.rig.controls])


def _actuators(channel: Callable[[RowGrid, str], np.ndarray]) -> ReadChannels:
    return lambda grid: np.column_stack([channel(grid, actuator.channel) for actuator in grid.drive.rig.actuators])


def _has_controls(rig: Rig) -> Sequence[bool]:
    return [control.name in rig.present_controls for control in rig.controls]


def _has_actuators(rig: Rig) -> Sequence[bool]:
    return [actuator.name in rig.present_actuators for actuator in rig.actuators]


COLUMNS.register("control")(Column(_controls(RowGrid.channel), (len(CONTROL),), _has_controls, ("ahead",)))
COLUMNS.register("control_causal")(
    Column(_controls(RowGrid.channel_causal), (len(CONTROL),), _has_controls, ("past",)),
)
COLUMNS.register("actuators")(Column(_actuators(RowGrid.channel), (len(ACTUATORS),), _has_actuators, ("target",)))
COLUMNS.register("actuators_causal")(
    Column(_actuators(RowGrid.channel_causal), (len(ACTUATORS),), _has_actuators, ("past", "start"))
)
