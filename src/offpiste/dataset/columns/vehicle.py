"""Columns of controls, actuators, states and surface normals, smoothed and causal."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import ACTUATORS, CONTROL, DT, STATE, WHEELS
from offpiste.dataset.columns import COLUMNS, Column, RowGrid, Segment
from offpiste.logs.motion import across_jumps, driven_slope
from offpiste.rig.rig import Rig


def _controls(rig: Rig) -> list[tuple[str, bool]]:
    """Return the channel of each control, and whether the rig's logs have it."""
    return [(control.name, control.name in rig.present_controls) for control in rig.controls]


def _actuators(rig: Rig) -> list[tuple[str, bool]]:
    return [(actuator.channel, actuator.name in rig.present_actuators) for actuator in rig.actuators]


def _register(name: str, of: Callable[[Rig], list[tuple[str, bool]]], count: int, *segments: Segment) -> None:
    """Register a column of several channels, causal if its name says so."""

    def read(grid: RowGrid) -> np.ndarray:
        return np.column_stack([grid.channel(each, causal=name.endswith("_causal")) for each, _ in of(grid.drive.rig)])

    COLUMNS.register(name)(Column(read, (count,), lambda rig: [present for _, present in of(rig)], segments))


_register("control", _controls, len(CONTROL), "ahead")
_register("control_causal", _controls, len(CONTROL), "past")
_register("actuators", _actuators, len(ACTUATORS), "target")
_register("actuators_causal", _actuators, len(ACTUATORS), "past", "start")

COLUMNS.register("state")(Column(lambda grid: grid.motion.state, (len(STATE),), segments=("target",), relative=True))
COLUMNS.register("state_causal")(
    Column(lambda grid: grid.motion.state_causal, (len(STATE),), segments=("past", "start"), relative=True)
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


def _by_set_and_wheel(grid: RowGrid) -> Float[np.ndarray, "1 N 4 3"]:
    return np.repeat(_driven_normal(grid, causal=False)[None, :, None], len(WHEELS), axis=2)


COLUMNS.register("normal")(Column(_by_set_and_wheel, (len(WHEELS), 3), segments=("past", "ahead"), by_feature_set=True))
COLUMNS.register("normal_causal")(Column(lambda grid: _driven_normal(grid, causal=True), (3,), segments=("past",)))
