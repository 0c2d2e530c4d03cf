"""Terrain and cost map under a block of lanes: cells are found for all lanes at once, numbers gathered, then computed.

There are no branches: lanes off the map read a cell of its border, and take something else where that does not count.
Four numbers are read at once (`vectors.read_fours`), in a quarter of the time that gathering instructions take.

The loops are inlined: a call passes seven words for each array through the stack, which took as long as the reading.
"""

from typing import NamedTuple

import numpy as np

from offpiste.dynamics.kernels.elementary import Lane, cos, f4, sin
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.rollout import CODES, NORMAL_ROW, UNKNOWN_ROW
from offpiste.dynamics.kernels.vectors import read_fours
from offpiste.mapping import terrain_map
from offpiste.native.compilation import PLANNING

on_map = PLANNING.inlined(terrain_map.on_map)
wheel_position = PLANNING.inlined(terrain_map.wheel_position)

COS, SIN, ALONG, ACROSS, FIRST_LAYER = range(5)
"""Rows of `TerrainSamples.values`: the heading, reach of errors along and across it, cost layers."""

POSE_POINT = 4
"""Number of the pose point among the places where layers are read, behind the wheels."""


class Grid(NamedTuple):
    """A map of cells.

    Attributes:
        shift: from the frame of the trajectories to cell [0, 0] [m].
        scale: cells per metre.
        rows, columns: how many cells.
    """

    shift: np.ndarray
    scale: Lane
    rows: int
    columns: int


class GroundCells(NamedTuple):
    """Cells that the model reads.

    Attributes:
        slope: [ny * max(nx, 2) * 2], NaN where unknown.
        codes: [ny * nx * E], the code for missing ones where there are no features.
        missing: code off the map [E].
        wheels: in the body frame [4, 2].
    """

    grid: Grid
    slope: np.ndarray
    codes: np.ndarray
    missing: np.ndarray
    wheels: np.ndarray


class CostCells(NamedTuple):
    """Cells that the cost reads: `costs.layers.CostMap`.

    Attributes:
        layers: [ny * nx * max(C, 4)].
        outside: value of each layer off the map [max(C, 4)].
    """

    grid: Grid
    layers: np.ndarray
    outside: np.ndarray


class TerrainSamples(NamedTuple):
    """Terrain and cost map under a block after a step, and the buffers to read them.

    Attributes:
        values: heading, reach of errors and layers, rows of lanes.
        cell: of the ground, nearest to each lane's wheel; -1 off the map.
        cost_cell: of the cost map, nearest to each lane's wheel or pose point; off the map -1 less it.
        corner: of the four cells of the ground around the wheel.
        first: index of the first number that is read.
        u, v: from the corner, in cells.
        read: what was just gathered, rows of lanes: the slope at the four cells, towards +x and +y, or layers.
    """

    values: np.ndarray
    cell: np.ndarray
    cost_cell: np.ndarray
    corner: np.ndarray
    first: np.ndarray
    u: np.ndarray
    v: np.ndarray
    read: np.ndarray


@PLANNING.maker
def make_samples(layers: int) -> TerrainSamples:
    """Buffers for a cost map of so many layers."""
    # Few allocations: LLVM gives a loop up as soon as it would have to compare too many of them for overlap.
    cells, numbers = np.zeros(4 * LANES, np.int32), np.zeros(10 * LANES, f4)
    return TerrainSamples(
        np.zeros((FIRST_LAYER + layers) * LANES, f4), cells[:LANES], cells[3 * LANES :], cells[LANES : 2 * LANES],
        cells[2 * LANES : 3 * LANES], numbers[:LANES], numbers[LANES : 2 * LANES], numbers[2 * LANES :],
    )  # fmt: skip


@PLANNING.inlined
def cell_at(grid: Grid, px: Lane, py: Lane) -> tuple[Lane, Lane, bool]:
    """Fractional cell of a place, moved onto the map, and whether it was on it; index and fraction are safe."""
    x, y = (px + grid.shift[0]) * grid.scale, (py + grid.shift[1]) * grid.scale
    last_x, last_y, half, zero = f4(grid.columns - 1), f4(grid.rows - 1), f4(0.5), f4(0)
    inside = on_map(x, y, last_x, last_y, half)
    # Comparisons are written so that what is not a number becomes 0.
    x = (x if x < last_x else last_x) if x > zero else zero
    y = (y if y < last_y else last_y) if y > zero else zero
    return x, y, inside


@PLANNING.inlined
def slope_columns(grid: Grid) -> int:
    """Columns of the slope: a single one is there twice."""
    return max(grid.columns, 2)


@PLANNING.inlined
def nearest_cell(grid: Grid, x: Lane, y: Lane) -> np.int32:
    """Index of the cell nearest to a fractional cell on the map."""
    return np.int32(np.rint(y)) * np.int32(grid.columns) + np.int32(np.rint(x))


@PLANNING.inlined
def find_cells(
    model_state: np.ndarray, heading: np.ndarray, wheel: np.ndarray, grid: Grid, cost_grid: Grid, cell: np.ndarray,
    corner: np.ndarray, u: np.ndarray, v: np.ndarray, cost_cell: np.ndarray,
) -> None:  # fmt: skip
    """Find the cells under a wheel; given arrays instead of `TerrainSamples`, LLVM makes vector code of it."""
    wx, wy, zero = wheel[0], wheel[1], f4(0)
    # A map of one row or column has no cell beyond the corner: the same one is taken twice.
    corner_x, corner_y = max(f4(grid.columns - 2), zero), max(f4(grid.rows - 2), zero)
    for i in range(LANES):
        c, s = heading[COS * LANES + i], heading[SIN * LANES + i]
        px, py = wheel_position(model_state[i], model_state[LANES + i], c, s, wx, wy)
        x, y, inside = cell_at(grid, px, py)
        cell[i] = nearest_cell(grid, x, y) if inside else -1
        x0, y0 = np.floor(x), np.floor(y)
        x0, y0 = x0 if x0 < corner_x else corner_x, y0 if y0 < corner_y else corner_y
        corner[i] = np.int32(y0) * np.int32(slope_columns(grid)) + np.int32(x0)
        u[i], v[i] = x - x0, y - y0
        x, y, inside = cell_at(cost_grid, px, py)
        nearest = nearest_cell(cost_grid, x, y)
        cost_cell[i] = nearest if inside else np.int32(-1) - nearest


@PLANNING.inlined
def find_pose_cells(model_state: np.ndarray, cost_cell: np.ndarray, cost_grid: Grid) -> None:
    """Find the cells of the cost map at the pose points."""
    for i in range(LANES):
        x, y, inside = cell_at(cost_grid, model_state[i], model_state[LANES + i])
        cell = nearest_cell(cost_grid, x, y)
        cost_cell[i] = cell if inside else np.int32(-1) - cell


@PLANNING.inlined
def find_numbers(cells: np.ndarray, size: int, index: np.ndarray) -> None:
    """Find where the numbers of cells begin that have so many each; negative off the map."""
    for i in range(LANES):
        index[i] = cells[i] * np.int32(size)


@PLANNING.inlined
def read_codes(w: np.ndarray, samples: TerrainSamples, ground: GroundCells, k: int) -> None:
    """Gather the codes under wheel k into the workspace."""
    size = len(ground.missing)
    find_numbers(samples.cell, size, samples.first)
    rows = w[(CODES + k * size) * LANES : (CODES + (k + 1) * size) * LANES]
    for e in range(0, size - 3, 4):
        read_fours(ground.codes, samples.first, e, ground.missing, rows[e * LANES :])
    for e in range(size - size % 4, size):
        for i in range(LANES):
            code = ground.codes[np.uint64(max(samples.first[i], np.int32(0)) + e)]
            rows[e * LANES + i] = code if samples.first[i] >= 0 else ground.missing[e]


@PLANNING.inlined
def read_slope(grid: Grid, slope: np.ndarray, corner: np.ndarray, index: np.ndarray, corners: np.ndarray) -> None:
    """Gather the slope of the four cells around a wheel: of the corner, its right neighbour, and both above."""
    find_numbers(corner, 2, index)
    up = 2 * slope_columns(grid) * min(grid.rows - 1, 1)
    read_fours(slope, index, 0, slope, corners)
    read_fours(slope, index, up, slope, corners[4 * LANES :])


@PLANNING.inlined
def add_normal(
    normal: np.ndarray, unknown: np.ndarray, s: np.ndarray, u: np.ndarray, v: np.ndarray, cell: np.ndarray
) -> None:
    """Add a quarter of a wheel's normal, from the slopes s; straight up where they are not known, which is counted."""
    quarter, zero, one = f4(0.25), f4(0), f4(1)
    for i in range(LANES):
        # As `terrain_map.bilinear`, but in two statements: in one LLVM rounds differently.
        x, y = u[i], v[i]
        rise_x = (s[i] * (one - x) + s[2 * LANES + i] * x) * (one - y)
        rise_x += (s[4 * LANES + i] * (one - x) + s[6 * LANES + i] * x) * y
        rise_y = (s[LANES + i] * (one - x) + s[3 * LANES + i] * x) * (one - y)
        rise_y += (s[5 * LANES + i] * (one - x) + s[7 * LANES + i] * x) * y
        known = (cell[i] >= 0) & (rise_x - rise_x == zero) & (rise_y - rise_y == zero)
        rise_x, rise_y = rise_x if known else zero, rise_y if known else zero
        up = quarter / np.sqrt(one + rise_x * rise_x + rise_y * rise_y)
        normal[i] -= rise_x * up
        normal[LANES + i] -= rise_y * up
        normal[2 * LANES + i] += up
        unknown[i] += zero if known else quarter


@PLANNING.inlined
def find_border_numbers(cells: np.ndarray, size: int, index: np.ndarray) -> None:
    """Find where the numbers of cells of the cost map begin; off the map those of the nearest cell."""
    for i in range(LANES):
        cell = cells[i]
        index[i] = (cell if cell >= 0 else np.int32(-1) - cell) * np.int32(size)


def read_layers(
    k: int, cost_cells: CostCells, cells: np.ndarray, index: np.ndarray, read: np.ndarray, values: np.ndarray
) -> None:
    """Read the layers under wheel k, or at the pose point; `kernel_costs` puts compiled code in its place."""
    raise NotImplementedError


def sample_terrain(
    w: np.ndarray,
    model_state: np.ndarray,
    samples: TerrainSamples,
    ground: GroundCells,
    cost_cells: CostCells,
) -> None:
    """Read normals and codes into the workspace, and the cost map into `samples.values`."""
    for i in range(LANES):
        samples.values[COS * LANES + i] = cos(model_state[2 * LANES + i])
        samples.values[SIN * LANES + i] = sin(model_state[2 * LANES + i])
    cost_cell = samples.cost_cell
    normal = w[NORMAL_ROW * LANES : (NORMAL_ROW + 3) * LANES]
    unknown = w[UNKNOWN_ROW * LANES : (UNKNOWN_ROW + 1) * LANES]
    normal[:], unknown[:] = f4(0), f4(0)
    for k in range(4):
        find_cells(
            model_state, samples.values, ground.wheels[k], ground.grid, cost_cells.grid, samples.cell, samples.corner,
            samples.u, samples.v, samples.cost_cell,
        )  # fmt: skip
        read_slope(ground.grid, ground.slope, samples.corner, samples.first, samples.read)
        add_normal(normal, unknown, samples.read, samples.u, samples.v, samples.cell)
        read_layers(k, cost_cells, cost_cell, samples.first, samples.read, samples.values)
        read_codes(w, samples, ground, k)
    find_pose_cells(model_state, cost_cell, cost_cells.grid)
    read_layers(POSE_POINT, cost_cells, cost_cell, samples.first, samples.read, samples.values)
