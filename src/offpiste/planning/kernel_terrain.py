"""What a block's wheels stand on: cells are found for all lanes at once, numbers gathered from them, and computed with.

Without branches and with one index a lane, reading becomes the processor's gathering instructions: lanes off the map
read cell 0, and do not use it.
"""

from typing import NamedTuple

import numpy as np

from offpiste.compilation import PLANNING
from offpiste.dynamics.kernels.elementary import Lane, cos, f4, sin
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.rollout import CODES, NORMAL_ROW

HAZARD, LIMIT, DISTANCE, ALONG_X, ALONG_Y, TARGET, COS, SIN = range(8)
"""Rows of what a block sees after a step; the first ones are the layers of the cost map."""

COST_NUMBERS = TARGET + 1
"""Of a cell of the cost map."""


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


class Ground(NamedTuple):
    """What the model reads, cell after cell.

    Attributes:
        slope: [ny * nx * 2], NaN where unknown.
        codes: [ny * nx * E], the code for missing ones where there are no features.
        missing: code off the map [E].
        wheels: in the body frame [4, 2].
    """

    grid: Grid
    slope: np.ndarray
    codes: np.ndarray
    missing: np.ndarray
    wheels: np.ndarray


class CostLayers(NamedTuple):
    """What the cost reads: `course.CostMap`, [ny * nx * 6]."""

    grid: Grid
    layers: np.ndarray
    outside: Lane


class Sight(NamedTuple):
    """What a block sees after a step, and what it takes to see it.

    Attributes:
        seen: for the cost, rows of lanes.
        cell, square: of the ground and of the raster, nearest to each lane's wheel; -1 off the map.
        corner: of the four cells of the ground around it.
        place: of the first number that is read.
        u, v: from the corner, in cells.
        slope: at the four cells, towards +x and +y, rows of lanes.
    """

    seen: np.ndarray
    cell: np.ndarray
    square: np.ndarray
    corner: np.ndarray
    place: np.ndarray
    u: np.ndarray
    v: np.ndarray
    slope: np.ndarray


@PLANNING.maker
def make_sight() -> Sight:
    """An empty one."""
    cells = np.zeros((4, LANES), np.int32)
    return Sight(
        np.zeros(8 * LANES, f4), cells[0], cells[1], cells[2], cells[3], np.zeros(LANES, f4), np.zeros(LANES, f4),
        np.zeros(8 * LANES, f4),
    )  # fmt: skip


@PLANNING.inlined
def cell_at(grid: Grid, px: Lane, py: Lane) -> tuple[Lane, Lane, bool]:
    """Fractional cell of a place, moved onto the map, and whether it was on it; index and fraction are safe."""
    x, y = (px + grid.shift[0]) * grid.scale, (py + grid.shift[1]) * grid.scale
    last_x, last_y, half, zero = f4(grid.columns - 1), f4(grid.rows - 1), f4(0.5), f4(0)
    inside = (x > -half) & (x < last_x + half) & (y > -half) & (y < last_y + half)
    # Comparisons are written so that what is not a number becomes 0.
    x = (x if x < last_x else last_x) if x > zero else zero
    y = (y if y < last_y else last_y) if y > zero else zero
    return x, y, inside


@PLANNING.inlined
def number(grid: Grid, x: Lane, y: Lane) -> np.int32:
    """Of the cell nearest to a fractional cell on the map."""
    return np.int32(np.rint(y)) * np.int32(grid.columns) + np.int32(np.rint(x))


@PLANNING.loop
def find(model_state: np.ndarray, sight: Sight, ground: Ground, cost_layers: CostLayers, k: int) -> None:
    """The cells under wheel k."""
    wx, wy, zero = ground.wheels[k, 0], ground.wheels[k, 1], f4(0)
    grid = ground.grid
    # A map of one row or column has no cell beyond the corner: `read` takes the same one twice.
    corner_x, corner_y = max(f4(grid.columns - 2), zero), max(f4(grid.rows - 2), zero)
    for i in range(LANES):
        c, s = sight.seen[COS * LANES + i], sight.seen[SIN * LANES + i]
        px, py = model_state[i] + c * wx - s * wy, model_state[LANES + i] + s * wx + c * wy
        x, y, inside = cell_at(grid, px, py)
        sight.cell[i] = number(grid, x, y) if inside else -1
        x0, y0 = np.floor(x), np.floor(y)
        x0, y0 = x0 if x0 < corner_x else corner_x, y0 if y0 < corner_y else corner_y
        sight.corner[i] = np.int32(y0) * np.int32(grid.columns) + np.int32(x0)
        sight.u[i], sight.v[i] = x - x0, y - y0
        x, y, inside = cell_at(cost_layers.grid, px, py)
        sight.square[i] = number(cost_layers.grid, x, y) if inside else -1


@PLANNING.loop
def locate(cells: np.ndarray, size: int, place: np.ndarray) -> None:
    """Where the numbers of cells begin that have so many each."""
    for i in range(LANES):
        place[i] = max(cells[i], np.int32(0)) * np.int32(size)


@PLANNING.loop
def read(w: np.ndarray, sight: Sight, ground: Ground, cost_layers: CostLayers, k: int, codes: bool) -> None:
    """What lies under wheel k."""
    read_slope(sight, ground)
    read_costs(sight, cost_layers)
    if codes:
        size = len(ground.missing)
        locate(sight.cell, size, sight.place)
        for e in range(size):
            row, missing = w[(CODES + k * size + e) * LANES : (CODES + k * size + e + 1) * LANES], ground.missing[e]
            for i in range(LANES):
                code = ground.codes[np.uint64(sight.place[i] + e)]
                row[i] = code if sight.cell[i] >= 0 else missing


@PLANNING.loop
def read_slope(sight: Sight, ground: Ground) -> None:
    """Of the four cells around a wheel."""
    right, up = min(ground.grid.columns - 1, 1), min(ground.grid.rows - 1, 1) * ground.grid.columns
    locate(sight.corner, 2, sight.place)
    for n in range(8):
        shift = np.int32(n % 2 + 2 * (right * (n // 2 % 2) + up * (n // 4)))
        row = sight.slope[n * LANES : (n + 1) * LANES]
        for i in range(LANES):
            row[i] = ground.slope[np.uint64(sight.place[i] + shift)]


@PLANNING.loop
def read_costs(sight: Sight, cost_layers: CostLayers) -> None:
    """Under a wheel."""
    quarter = f4(0.25)
    hazard, limit = sight.seen[HAZARD * LANES : (HAZARD + 1) * LANES], sight.seen[LIMIT * LANES : (LIMIT + 1) * LANES]
    locate(sight.square, COST_NUMBERS, sight.place)
    for i in range(LANES):
        found, other = cost_layers.layers[np.uint64(sight.place[i])], cost_layers.layers[np.uint64(sight.place[i] + 1)]
        inside = sight.square[i] >= 0
        hazard[i] += quarter * (found if inside else cost_layers.outside)
        limit[i] = other if inside & (other < limit[i]) else limit[i]


@PLANNING.loop
def lean(w: np.ndarray, sight: Sight) -> None:
    """Add a quarter of a wheel's normal; straight up where the slope is not known."""
    s, quarter, zero, one = sight.slope, f4(0.25), f4(0), f4(1)
    for i in range(LANES):
        u, v = sight.u[i], sight.v[i]
        rise_x = (s[i] * (one - u) + s[2 * LANES + i] * u) * (one - v)
        rise_x += (s[4 * LANES + i] * (one - u) + s[6 * LANES + i] * u) * v
        rise_y = (s[LANES + i] * (one - u) + s[3 * LANES + i] * u) * (one - v)
        rise_y += (s[5 * LANES + i] * (one - u) + s[7 * LANES + i] * u) * v
        known = (sight.cell[i] >= 0) & (rise_x - rise_x == zero) & (rise_y - rise_y == zero)
        rise_x, rise_y = rise_x if known else zero, rise_y if known else zero
        up = quarter / np.sqrt(one + rise_x * rise_x + rise_y * rise_y)
        w[NORMAL_ROW * LANES + i] -= rise_x * up
        w[(NORMAL_ROW + 1) * LANES + i] -= rise_y * up
        w[(NORMAL_ROW + 2) * LANES + i] += up


@PLANNING.loop
def sample_terrain(
    w: np.ndarray, model_state: np.ndarray, sight: Sight, ground: Ground, cost_layers: CostLayers, codes: bool
) -> None:
    """Normals, and codes if wanted, under the wheels into the workspace, layers of the cost into `sight.seen`."""
    seen = sight.seen
    for i in range(LANES):
        seen[COS * LANES + i] = cos(model_state[2 * LANES + i])
        seen[SIN * LANES + i] = sin(model_state[2 * LANES + i])
    w[NORMAL_ROW * LANES : (NORMAL_ROW + 3) * LANES] = f4(0)
    seen[HAZARD * LANES : (HAZARD + 1) * LANES] = f4(0)
    seen[LIMIT * LANES : (LIMIT + 1) * LANES] = f4(np.inf)
    for k in range(4):
        find(model_state, sight, ground, cost_layers, k)
        read(w, sight, ground, cost_layers, k, codes)
        lean(w, sight)
    for i in range(LANES):
        x, y, _ = cell_at(cost_layers.grid, model_state[i], model_state[LANES + i])
        sight.square[i] = number(cost_layers.grid, x, y)
    locate(sight.square, COST_NUMBERS, sight.place)
    for k in range(DISTANCE, TARGET + 1):
        for i in range(LANES):
            seen[k * LANES + i] = cost_layers.layers[np.uint64(sight.place[i] + k)]
    for i in range(LANES):
        seen[DISTANCE * LANES + i] += (model_state[i] - model_state[i]) + (
            model_state[LANES + i] - model_state[LANES + i]
        )
