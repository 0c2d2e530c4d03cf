"""Columns of how the vehicle moved and of the slope of the path that it drove; each also as known at the time."""

import numpy as np
from jaxtyping import Float

from offpiste.conventions import DT, STATE, WHEELS
from offpiste.dataset.columns import COLUMNS, Column, RowGrid
from offpiste.logs.motion import across_jumps, driven_slope

COLUMNS.register("state")(
    Column(read=lambda grid: grid.motion.state, shape=(len(STATE),), segments=("target",), relative=True)
)
COLUMNS.register("state_causal")(
    Column(read=lambda grid: grid.motion.state_causal, shape=(len(STATE),), segments=("past", "start"), relative=True)
)


def _driven_normal(grid: RowGrid, *, causal: bool) -> Float[np.ndarray, "N 3"]:
    """Normal of a plane that rises along the heading as the driven path does."""
    slope = _slope(grid, causal=causal)
    yaw = (grid.motion.state_causal if causal else grid.motion.state)[:, 2]
    normal = np.stack((-slope * np.cos(yaw), -slope * np.sin(yaw), np.ones_like(slope)), axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _slope(grid: RowGrid, *, causal: bool) -> Float[np.ndarray, " N"]:
    """Slope of the driven path, or flat ground where the rig or the log has no elevation."""
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
