"""Columns `state`, `state_causal` and `normal`: how the vehicle moved, and the slope of the path that it drove."""

import numpy as np
from jaxtyping import Float

from offpiste.conventions import DT, STATE, WHEELS
from offpiste.dataset.columns import COLUMNS, Column, RowGrid
from offpiste.logs.motion import driven_slope

COLUMNS.register("state")(
    Column(read=lambda grid: grid.motion.state, shape=(len(STATE),), segments=("target",), relative=True)
)
COLUMNS.register("state_causal")(
    Column(read=lambda grid: grid.motion.state_causal, shape=(len(STATE),), segments=("past", "start"), relative=True)
)


def _driven_normal(grid: RowGrid) -> Float[np.ndarray, "1 N 4 3"]:
    """Normal of a plane that rises along the heading as the driven path does; the same under all wheels."""
    slope, yaw = _slope(grid), grid.motion.state[:, 2]
    normal = np.stack((-slope * np.cos(yaw), -slope * np.sin(yaw), np.ones_like(slope)), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.repeat(normal[None, :, None], len(WHEELS), axis=2)


def _slope(grid: RowGrid) -> Float[np.ndarray, " N"]:
    """Slope of the driven path, or flat ground where the rig or the log has no elevation."""
    rig, state, place = grid.drive.rig, grid.motion.state, grid.drive.channels["position"]
    if rig.motion.normals == "flat" or place.values.shape[1] < 3:
        return np.zeros(len(grid.time))
    position = place.linear(grid.time, max_gap=rig.clock.max_gap)
    speed = np.copysign(np.hypot(state[:, 3], state[:, 4]), state[:, 3])
    return driven_slope(position, speed, dt=DT, length=rig.motion.slope_length)


COLUMNS.register("normal")(
    Column(read=_driven_normal, shape=(len(WHEELS), 3), segments=("past", "ahead"), by_feature_set=True)
)
