"""Columns of controls, actuators, states and surface normals, smoothed and causal."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import ACTUATORS, CONTROL, DT, STATE, WHEELS
from offpiste.dataset.columns import COLUMNS, Column, RowGrid
from offpiste.logs.motion import across_jumps, driven_slope
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

COLUMNS.register("state")(
    Column(read=lambda grid: grid.motion.state, shape=(len(STATE),), segments=("target",), relative=True)
)
COLUMNS.register("state_causal")(
    Column(read=lambda grid: grid.motion.state_causal, shape=(len(STATE),), segments=("past", "start"), relative=True)
)


def _driven_normal(grid: RowGrid, *, causal: bool) -> Float[np.ndarray, "N 3"]:
    """Return the normal of a plane that rises along the heading like the driven path."""
    slope = _slope(grid, causal=causal)
    yaw = (grid.motion.state_causal if causal else grid.motion.state)[:, 2]
    normal = np.stack((-slope * np.cos(yaw), -slope * np.sin(yaw), np.ones_like(slope)), axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _slope(grid: RowGrid, *, causal: bool) -> Float[np.ndarray, " N"]:
    """Return the slope of the driven path; zero without elevation in the rig or the log."""
    rig, place, gap = grid.drive.rig, grid.drive.channels["position"], grid.drive.rig.clock.max_gap
    if rig.motion.normals == "flat" or place.values.shape[1] < 3:
        return np.zeros(len(grid.time))
    state = grid.motion.state_causal if causal else grid.motion.state
    position = (place.latest if causal else place.linear)(grid.time, max_gap=gap)
    position[across_jumps(grid.drive, grid.time, causal=causal)] = np.nan
    speed = np.copysign(np.hypot(state[:, 3], state[:, 4]), state[:, 3])
    return driven_slope(position, speed, dt=DT, length=rig.motion.slope_length, causal=causal)


def _by_set_and_wheel(normal: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "1 N 4 3"]:
    return np.repeat(normal[None, :, None], len(WHEELS), axis=2)


COLUMNS.register("normal")(
    Column(
        read=lambda grid: _by_set_and_wheel(_driven_normal(grid, causal=False)),
        shape=(len(WHEELS), 3),
        segments=("past", "ahead"),
        by_feature_set=True,
    )
)
COLUMNS.register("normal_causal")(
    Column(read=lambda grid: _driven_normal(grid, causal=True), shape=(3,), segments=("past",))
)
