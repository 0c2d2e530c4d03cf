"""What is published about a drive: the plan, the map, and how its parts are."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.logs.ros.grid_map import grid_map_from_layers
from offpiste.logs.ros.writer import header, make, quaternion, vector
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.runtime.prediction import Prediction

PLAN: Final = "/offpiste/plan"
"""Topic of the plan's predicted path (nav_msgs/Path)."""
MAP: Final = "/offpiste/map"
"""Topic of the map (grid_map_msgs/GridMap)."""
DIAGNOSTICS: Final = "/diagnostics"
"""Topic of the state of each process (diagnostic_msgs/DiagnosticArray)."""
OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_EVERY: Final = 5
"""Steps of a prediction from one published pose to the next."""


def path_message(prediction: Prediction, stamp_ns: int, frame: str, layers: TerrainLayers | None) -> Any:
    """A nav_msgs/Path of a prediction.

    Args:
        layers: of the map, on whose ground it lies; where the ground is not known, on that of the nearest place along
            the path, and on the height 0 without any.
    """
    places, poses = prediction.state[::_EVERY, :3], []
    height = np.full(len(places), np.nan) if layers is None else ground_height(layers, places[:, :2])
    known = np.flatnonzero(np.isfinite(height))
    height = np.interp(np.arange(len(height)), known, height[known]) if len(known) else np.zeros(len(height))
    for (x, y, yaw), z in zip(places.tolist(), height.tolist(), strict=True):
        turn = quaternion((0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)))
        pose = make("geometry_msgs/Pose", position=vector((x, y, z), "geometry_msgs/Point"), orientation=turn)
        poses.append(make("geometry_msgs/PoseStamped", header=header(stamp_ns, frame), pose=pose))
    return make("nav_msgs/Path", header=header(stamp_ns, frame), poses=poses)


def ground_height(layers: TerrainLayers, xy: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " N"]:
    """Height of the ground at places x, y [m]; NaN where the map does not know it."""
    cell = np.rint((xy - layers.origin) / layers.resolution).astype(int)
    inside = ((cell >= 0) & (cell < layers.known.shape[::-1])).all(axis=1)
    height = np.full(len(xy), np.nan)
    height[inside] = layers.elevation[cell[inside, 1], cell[inside, 0]]
    return height


def map_message(layers: TerrainLayers, stamp_ns: int, frame: str) -> Any:
    """A grid_map_msgs/GridMap of the ground: its height, slope, roughness and obstacles; NaN where not known."""
    names = ("elevation", "slope", "roughness", "obstacle_height")
    shown = {name: np.asarray(getattr(layers, name), np.float64) for name in names}
    origin = (float(layers.origin[0]), float(layers.origin[1]))
    return grid_map_from_layers(shown, origin, layers.resolution, stamp_ns=stamp_ns, frame=frame)


def diagnostics_message(parts: Mapping[str, tuple[int, str, Mapping[str, Any]]], stamp_ns: int) -> Any:
    """A diagnostic_msgs/DiagnosticArray.

    Args:
        parts: level, message and numbers of each process.
    """
    status = [
        make(
            "diagnostic_msgs/DiagnosticStatus",
            level=level,
            name=f"offpiste: {name}",
            message=message,
            hardware_id="",
            values=[make("diagnostic_msgs/KeyValue", key=key, value=text) for key, text in _texts(numbers)],
        )
        for name, (level, message, numbers) in parts.items()
    ]
    return make("diagnostic_msgs/DiagnosticArray", header=header(stamp_ns, ""), status=status)


def _texts(numbers: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Numbers as texts; those of mappings one by one."""
    found: list[tuple[str, str]] = []
    for key, value in numbers.items():
        if isinstance(value, Mapping):
            found += [(f"{key}: {name}", str(count)) for name, count in value.items()]
        else:
            found.append((key, f"{value:.4g}" if isinstance(value, float) else str(value)))
    return found
