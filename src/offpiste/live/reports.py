"""What is published about a drive: the plan, the map, and how its parts are."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

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


def path_message(prediction: Prediction, stamp_ns: int, frame: str) -> Any:
    """A nav_msgs/Path of a prediction, on the height 0."""
    poses = []
    for x, y, yaw in prediction.state[::_EVERY, :3].tolist():
        turn = quaternion((0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)))
        pose = make("geometry_msgs/Pose", position=vector((x, y, 0.0), "geometry_msgs/Point"), orientation=turn)
        poses.append(make("geometry_msgs/PoseStamped", header=header(stamp_ns, frame), pose=pose))
    return make("nav_msgs/Path", header=header(stamp_ns, frame), poses=poses)


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
