"""Round trips of layers through grid_map messages, and layouts of other writers."""

import numpy as np
import pytest

from offpiste.core.errors import LogError
from offpiste.logs.ros.grid_map import grid_map_from_layers, layers_from_grid_map
from offpiste.logs.ros.writer import message_types

NY, NX = 3, 5
ORIGIN, RESOLUTION = (-2.0, 10.0), 0.5


def layer() -> np.ndarray:
    """Return a layer whose node [j, i] is 10 j + i: neither square nor symmetric."""
    return 10.0 * np.arange(NY)[:, None] + np.arange(NX)


def message(**layers: np.ndarray) -> object:
    return grid_map_from_layers(layers, ORIGIN, RESOLUTION, stamp_ns=0)


def position_of_index(made: object, row: int, column: int) -> tuple[float, float]:
    """grid_map_core's getPositionFromIndex: half a cell from the corner at +x, +y, rows to -x, columns to -y."""
    info = made.info
    x = info.pose.position.x + info.length_x / 2 - (row + 0.5) * info.resolution
    y = info.pose.position.y + info.length_y / 2 - (column + 0.5) * info.resolution
    return x, y


def test_every_cell_lies_where_grid_map_says() -> None:
    made = message(elevation=layer())
    sizes = {dim.label: dim.size for dim in made.data[0].layout.dim}
    assert sizes == {"column_index": NY, "row_index": NX}
    assert [dim.stride for dim in made.data[0].layout.dim] == [15, 5]
    for column in range(NY):
        for row in range(NX):
            x, y = position_of_index(made, row, column)
            i, j = (x - ORIGIN[0]) / RESOLUTION, (y - ORIGIN[1]) / RESOLUTION
            # Eigen stores a matrix of NX rows column by column.
            assert made.data[0].data[column * NX + row] == 10 * j + i


def test_there_and_back_through_bytes() -> None:
    store, name = message_types(), "grid_map_msgs/msg/GridMap"
    made = message(elevation=layer(), friction=layer() ** 2)
    read = layers_from_grid_map(store.deserialize_cdr(bytes(store.serialize_cdr(made, name)), name))
    assert read.origin == ORIGIN
    assert read.resolution == RESOLUTION
    assert list(read.layers) == ["elevation", "friction"]
    np.testing.assert_array_equal(read.layers["elevation"], layer())
    np.testing.assert_array_equal(read.layers["friction"], layer() ** 2)


def test_a_circular_buffer_is_unrolled() -> None:
    made = message(elevation=layer())
    matrix = made.data[0].data.reshape(NY, NX).T  # [row, column]
    # grid_map keeps logical index k at buffer index (k + start) modulo the size.
    buffer = np.roll(matrix, (2, 1), axis=(0, 1))
    made.data[0].data = np.ascontiguousarray(buffer.T).reshape(-1)
    made.outer_start_index, made.inner_start_index = 2, 1
    np.testing.assert_array_equal(layers_from_grid_map(made).layers["elevation"], layer())


def test_what_is_not_read() -> None:
    turned = message(elevation=layer())
    turned.info.pose.orientation.z = 0.1
    with pytest.raises(LogError, match="rotated against its frame"):
        layers_from_grid_map(turned)
    rows = message(elevation=layer())
    rows.data[0].layout.dim.reverse()
    with pytest.raises(LogError, match="'elevation' of a grid map is not stored column by column"):
        layers_from_grid_map(rows)
    short = message(elevation=layer())
    short.data[0].data = short.data[0].data[:-1]
    with pytest.raises(LogError, match="not stored column by column"):
        layers_from_grid_map(short)
