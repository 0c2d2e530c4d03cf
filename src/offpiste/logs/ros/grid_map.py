"""Conversion of map layers to and from grid_map_msgs/GridMap.

Here, node [j, i] is at (origin x + i resolution, origin y + j resolution). In grid_map (Fankhauser and Hutter, "A
Universal Grid Map Library", 2016), index (0, 0) is at the largest x and y, rows run along -x, columns along -y, and
matrices are stored column by column; a circular buffer may start anywhere.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError
from offpiste.logs.ros.writer import header, make, quaternion, vector


@dataclass(frozen=True)
class MapLayers:
    """Named layers of equal size."""

    origin: tuple[float, float]  # x, y of node [0, 0] in the frame of the message [m]
    resolution: float  # spacing of the nodes [m]
    layers: dict[str, Float[np.ndarray, "ny nx"]]


def grid_map_from_layers(
    layers: Mapping[str, Float[np.ndarray, "ny nx"]],
    origin: tuple[float, float],
    resolution: float,
    *,
    stamp_ns: int,
    frame: str = "map",
) -> Any:
    """Return a grid_map_msgs/GridMap of layers, in float32."""
    ny, nx = next(iter(layers.values())).shape
    middle = (origin[0] + (nx - 1) / 2 * resolution, origin[1] + (ny - 1) / 2 * resolution, 0.0)
    pose = make(
        "geometry_msgs/Pose", position=vector(middle, "geometry_msgs/Point"), orientation=quaternion((0, 0, 0, 1))
    )
    length_x, length_y = nx * resolution, ny * resolution
    info = make("grid_map_msgs/GridMapInfo", resolution=resolution, length_x=length_x, length_y=length_y, pose=pose)
    return make(
        "grid_map_msgs/GridMap",
        header=header(stamp_ns, frame),
        info=info,
        layers=list(layers),
        basic_layers=[],
        data=[_matrix(layer) for layer in layers.values()],
        outer_start_index=0,
        inner_start_index=0,
    )


def layers_from_grid_map(message: Any) -> MapLayers:
    """Return the layers of a grid map that is aligned with its frame."""
    info = message.info
    turn = info.pose.orientation
    if max(abs(turn.x), abs(turn.y), abs(turn.z)) > 1e-6:
        raise LogError("a grid map is rotated against its frame", how="record it in a frame along its axes")
    start = message.outer_start_index, message.inner_start_index
    layers = {name: _layer(name, array, start) for name, array in zip(message.layers, message.data, strict=True)}
    # The centre is (n - 1)/2 cells from the first cell; n is taken from the matrices, since lengths are rounded.
    ny, nx = next(iter(layers.values())).shape if layers else (1, 1)
    middle = info.pose.position
    origin = (middle.x - (nx - 1) / 2 * info.resolution, middle.y - (ny - 1) / 2 * info.resolution)
    return MapLayers(origin, info.resolution, layers)


def _matrix(layer: Float[np.ndarray, "ny nx"]) -> Any:
    """Return a layer stored column by column: rows with both axes reversed."""
    ny, nx = layer.shape
    columns = make("std_msgs/MultiArrayDimension", label="column_index", size=ny, stride=ny * nx)
    rows = make("std_msgs/MultiArrayDimension", label="row_index", size=nx, stride=nx)
    layout = make("std_msgs/MultiArrayLayout", dim=[columns, rows], data_offset=0)
    data = np.ascontiguousarray(layer[::-1, ::-1], dtype=np.float32).reshape(-1)
    return make("std_msgs/Float32MultiArray", layout=layout, data=data)


def _layer(name: str, array: Any, start: tuple[int, int]) -> Float[np.ndarray, "ny nx"]:
    dims = {dim.label: dim.size for dim in array.layout.dim}
    rows, columns = dims.get("row_index", 0), dims.get("column_index", 0)
    data = np.asarray(array.data)[array.layout.data_offset :]
    if [dim.label for dim in array.layout.dim] != ["column_index", "row_index"] or rows * columns != len(data):
        raise LogError(f"layer '{name}' of a grid map is not stored column by column", how="record it with grid_map")
    # outer_start_index counts rows, inner_start_index columns (grid_map_ros, GridMapRosConverter).
    matrix = np.roll(data.reshape(columns, rows), (-start[1], -start[0]), axis=(0, 1))
    return np.ascontiguousarray(matrix[::-1, ::-1])
