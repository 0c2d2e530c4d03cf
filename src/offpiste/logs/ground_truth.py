"""Ground truth of simulated logs, for oracle experiments only."""

from pathlib import Path
from typing import Final

import numpy as np

from offpiste.core.errors import LogError
from offpiste.logs.log import open_log
from offpiste.logs.ros.grid_map import MapLayers, layers_from_grid_map

GROUND_PROPERTIES: Final = ("friction", "cornering_stiffness", "rolling_resistance", "sinkage_drag")
"""Properties of simulated ground: largest horizontal force over load [1], lateral force over load per small slip angle
[1/rad], rolling resistance over load [1], and further resistance over load at full wheel slip [1]."""

GROUND_KINDS: Final = ("packed_sand", "loose_sand", "dirt_trail", "gravel", "mud", "dry_grass", "wet_grass")
"""Kinds of simulated ground; their properties are listed in simulation/world/grounds.toml."""

WHEELS_TOPIC, MAP_TOPIC = "/truth/wheels", "/truth/map"

WHEEL = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", *GROUND_PROPERTIES, "load", "slip_ratio", "slip_angle", "kind")]
)
"""Record of a wheel on `WHEELS_TOPIC`: contact point in the world frame [m], ground properties there, normal load [N],
slip ratio within [-1, 1], slip angle [rad], index into `GROUND_KINDS`; in the order of the rig's `wheel_positions`."""


def read_truth_map(path: str | Path) -> MapLayers:
    """Read the true map of a simulated drive: `elevation` [m], properties, share of each ground kind, `wetness`."""
    log, how = open_log(path), "record one with `offpiste simulate`"
    if not log.has_messages or not {WHEELS_TOPIC, MAP_TOPIC} <= set(log.topics):
        raise LogError("no ground truth in it: only simulated logs have it", where=path, how=how)
    grid = next((message for _, message in log.messages(MAP_TOPIC)), None)
    if grid is None:
        raise LogError("its true map is missing", where=path, how=how)
    return layers_from_grid_map(grid)
