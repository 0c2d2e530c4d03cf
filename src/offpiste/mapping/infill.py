"""Layers of a map, whose gaps are filled from the nearest cell: of rows, or of some cells to the same bit."""

import numpy as np

from offpiste.mapping.ground import CENTRE, FEATURE_HEIGHT, HEIGHT, OBSTACLE, RISE_X, RISE_Y, ROUGHNESS
from offpiste.mapping.normals import fit_planes
from offpiste.native.library import compiled


@compiled(
    int, int, *2 * (float,), "i8", int, "f4", int, int, "f4", *3 * (int,), "f8", *6 * ("f4",), *3 * ("?",)
)  # fmt: skip
def write_layers(  # type: ignore[no-untyped-def]
    first, last, floor, limit, offsets, count, grids, cells, border, features, channels, start_x, start_y, *layers
):
    """Write the layers of the rows `first` to `last` - 1.

    Args:
        floor: height of the reference level in the world [m].
        limit: maximum height of features above or below the ground [m].
        offsets: rows and columns to neighbours, nearest first, the cell itself at [0] [count, 2].
        grids: with `border` cells around [cells, cells] (`ground.make_grids`).
        features, start_x, start_y: as in `ground.see_columns`.
        layers: of `TerrainLayers`, in their order; features and distance are NaN where not `valid`.
    """
    rows, columns = (each.ravel() for each in np.mgrid[first:last, :cells])
    values = _values(rows, columns, floor, limit, offsets, grids, border, features, start_x, start_y)
    for layer, value in zip(layers, values, strict=True):
        layer[first:last] = value.reshape(layer[first:last].shape)


@compiled(
    "i8", "i8", int, int, *3 * (float,), "i8", int, "f4", int, int, "f4", *3 * (int,), "f8", *3 * ("f4",), "?", "?"
)  # fmt: skip
def read_cells(  # type: ignore[no-untyped-def]
    rows, columns, wanted, radius, size, floor, limit, offsets, count, grids, cells, border, features, channels,
    start_x, start_y, *layers,
):  # fmt: skip
    """Write the values that `fit_planes` and `write_layers` give at some cells.

    Args:
        rows, columns: of the cells, inside the map [wanted].
        radius, size: as in `fit_planes`; the other arguments are those of `write_layers`.
        layers: of `voxels_to_layers.MapCells`, in their order.
    """
    fit_planes.plain(0, cells, radius, size, grids, cells, border)
    values = _values(rows, columns, floor, limit, offsets, grids, border, features, start_x, start_y)
    for layer, number in zip(layers, (0, 1, 5, 6, 7, 9), strict=True):
        layer[:] = values[number]


def _values(
    rows: np.ndarray,
    columns: np.ndarray,
    floor: float,
    limit: float,
    offsets: np.ndarray,
    grids: np.ndarray,
    border: int,
    features: np.ndarray,
    start_x: int,
    start_y: int,
) -> tuple[np.ndarray, ...]:
    """Return the values of all layers at some cells."""
    near = rows + offsets[:, :1], columns + offsets[:, 1:]
    around = near[0] + border, near[1] + border
    each, here = np.arange(len(rows)), ~np.isnan(grids[HEIGHT][around])
    which, known = here.argmax(axis=0), here.any(axis=0)
    source = around[0][which, each], around[1][which, each]
    names = HEIGHT, OBSTACLE, RISE_X, RISE_Y, CENTRE, ROUGHNESS
    height, obstacle, rise_x, rise_y, centre, roughness = (
        np.where(known, grids[name][source], np.float32(np.nan)) for name in names
    )
    fits = np.abs(grids[FEATURE_HEIGHT][around] - height) <= limit
    which_feature, valid = fits.argmax(axis=0), fits.any(axis=0)
    j, i = (side[which_feature, each] for side in near)
    seen = features[(start_y + j) % len(features), (start_x + i) % len(features)]
    seen[~valid] = np.nan
    squared = rise_x * rise_x + rise_y * rise_y
    up = 1 / np.sqrt(1 + squared)
    normal = np.column_stack((-rise_x * up, -rise_y * up, up))
    ground = floor + centre.astype(np.float64), normal, np.sqrt(squared), roughness, obstacle
    return *ground, seen[:, 1:], seen[:, 0], known, known & (which == 0), valid
