"""Ground truth of simulated logs, for oracle experiments only."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.errors import LogError
from offpiste.logs.log import Log, open_log
from offpiste.logs.ros.grid_map import MapLayers, layers_from_grid_map
from offpiste.logs.ros.sensor_messages import points_from_message

GROUND_PROPERTIES: Final = ("friction", "cornering_stiffness", "rolling_resistance", "sinkage_drag")
"""Properties of simulated ground: largest horizontal force over load [1], lateral force over load per small slip angle
[1/rad], rolling resistance over load [1], and further resistance over load at full wheel slip [1]."""

GROUND_KINDS: Final = ("packed_sand", "loose_sand", "dirt_trail", "gravel", "mud", "dry_grass", "wet_grass")
"""Kinds of simulated ground; their properties are listed in simulation/world/grounds.toml."""

WHEELS_TOPIC, MAP_TOPIC = "/truth/wheels", "/truth/map"

WHEEL = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", *GROUND_PROPERTIES, "load", "slip_ratio", "slip_angle", "kind")]
)
"""Record of a wheel on `WHEELS_TOPIC`, in the units of `Truth`."""


@dataclass(frozen=True)
class Truth:
    """Ground truth of a drive; wheels are front-left, front-right, rear-left, rear-right."""

    time: Float[np.ndarray, " n"]  # header stamps [s]
    contact: Float[np.ndarray, "n 4 3"]  # contact points of the wheels in the world frame [m]
    properties: Float[np.ndarray, "n 4 4"]  # `GROUND_PROPERTIES` at the contact points
    kind: Int[np.ndarray, "n 4"]  # index into `GROUND_KINDS` at the contact points
    load: Float[np.ndarray, "n 4"]  # normal load [N]
    slip_ratio: Float[np.ndarray, "n 4"]  # limited to [-1, 1]
    slip_angle: Float[np.ndarray, "n 4"]  # [rad]
    map: MapLayers  # `elevation` [m], ground properties, share of each ground kind, `wetness`


def read_truth(path: str | Path) -> Truth:
    """Read the ground truth of a simulated drive.

    Raises:
        LogError: the log has none, or cannot be read.
    """
    log, layers = _simulated(path), read_truth_map(path)
    rows = [(time, points_from_message(message)) for time, message in log.messages(WHEELS_TOPIC)]
    if not rows or any(len(points) != 4 or points.dtype.names != WHEEL.names for _, points in rows):
        raise LogError("its ground truth is incomplete", where=path, how="record it again with `offpiste simulate`")
    wheels = np.stack([points for _, points in rows])
    return Truth(
        time=np.array([time for time, _ in rows]),
        contact=_columns(wheels, ("x", "y", "z")),
        properties=_columns(wheels, GROUND_PROPERTIES),
        kind=wheels["kind"].astype(np.int64),
        load=wheels["load"].astype(np.float64),
        slip_ratio=wheels["slip_ratio"].astype(np.float64),
        slip_angle=wheels["slip_angle"].astype(np.float64),
        map=layers,
    )


def read_truth_map(path: str | Path) -> MapLayers:
    """Read the true map of a simulated drive."""
    grid = next((message for _, message in _simulated(path).messages(MAP_TOPIC)), None)
    if grid is None:
        raise LogError("its true map is missing", where=path, how="record it again with `offpiste simulate`")
    return layers_from_grid_map(grid)


def _simulated(path: str | Path) -> Log:
    log = open_log(path)
    if not log.has_messages or not {WHEELS_TOPIC, MAP_TOPIC} <= set(log.topics):
        what = "no ground truth in it: only simulated logs have it"
        raise LogError(what, where=path, how="record one with `offpiste simulate`")
    return log


def _columns(wheels: np.ndarray, names: tuple[str, ...]) -> Float[np.ndarray, "n 4 k"]:
    return np.stack([wheels[name].astype(np.float64) for name in names], axis=2)
