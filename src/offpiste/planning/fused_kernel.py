"""Rollouts on a map with their costs, in one kernel: the generated step, map lookups and the terms of the cost.

Blocks of lanes are rolled out one after another, as in `dynamics.kernels.rollout`. What the wheels stand on after a
step is looked up once: the step's cost reads it, and so does the next step.
"""

import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from offpiste.dynamics.kernels.elementary import Lane, cos, f4, maximum, sin
from offpiste.dynamics.kernels.jit import entry, inlined, lane_loop
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.rollout import (
    CODES,
    CONTROL_ROW,
    MOVED,
    NORMAL_ROW,
    STATES,
    Networks,
    advance_block,
    make_scratches,
)
from offpiste.planning import terms

path_term = inlined(terms.path_term)
speed_term = inlined(terms.speed_term)
overspeed_term = inlined(terms.overspeed_term)
lateral_ratio = inlined(terms.lateral_ratio)
rollover_term = inlined(terms.rollover_term)
effort_term = inlined(terms.effort_term)
jerk_term = inlined(terms.jerk_term)

HAZARD, LIMIT, DISTANCE, ALONG_X, ALONG_Y, TARGET, COS, SIN = range(8)
"""Rows of what a block sees after a step."""


class Grid(NamedTuple):
    """A map of cells.

    Attributes:
        shift: from the frame of the trajectories to cell [0, 0] [m].
        scale: cells per metre.
    """

    shift: np.ndarray
    scale: Lane


class Ground(NamedTuple):
    """What the model reads.

    Attributes:
        slope: [ny, nx, 2], NaN where unknown.
        codes: [ny, nx, E], the code for missing ones where there are no features.
        missing: code off the map [E].
        wheels: in the body frame [4, 2].
    """

    grid: Grid
    slope: np.ndarray
    codes: np.ndarray
    missing: np.ndarray
    wheels: np.ndarray


class Raster(NamedTuple):
    """What the cost reads: `course.CostMap`."""

    grid: Grid
    layers: np.ndarray
    outside: Lane


class Prices(NamedTuple):
    """`costs.Weights` in float32, with what else the terms need."""

    path: Lane
    speed: Lane
    overspeed: Lane
    rollover: Lane
    lateral_limit: Lane
    least_vertical: Lane
    gravity: Lane
    dt: Lane
    effort: np.ndarray
    jerk: np.ndarray


@inlined
def cell_at(grid: Grid, nx: int, ny: int, px: Lane, py: Lane) -> tuple[Lane, Lane, bool]:
    """Fractional cell of a place, moved onto the map, and whether it was on it; index and fraction are safe."""
    x, y = (px + grid.shift[0]) * grid.scale, (py + grid.shift[1]) * grid.scale
    last_x, last_y, half, zero = f4(nx - 1), f4(ny - 1), f4(0.5), f4(0)
    inside = x > -half and x < last_x + half and y > -half and y < last_y + half
    # Comparisons are written so that what is not a number becomes 0.
    x = (x if x < last_x else last_x) if x > zero else zero
    y = (y if y < last_y else last_y) if y > zero else zero
    return x, y, inside


@inlined
def rise_at(slope: np.ndarray, x: Lane, y: Lane) -> tuple[Lane, Lane]:
    """Bilinear slopes at a fractional cell on the map; NaN next to unknown cells."""
    ny, nx, _ = slope.shape
    x0, y0 = min(np.int64(x), max(nx - 2, 0)), min(np.int64(y), max(ny - 2, 0))
    x1, y1 = min(x0 + 1, nx - 1), min(y0 + 1, ny - 1)
    u, v, one = x - f4(x0), y - f4(y0), f4(1)
    rise_x = (slope[y0, x0, 0] * (one - u) + slope[y0, x1, 0] * u) * (one - v)
    rise_x += (slope[y1, x0, 0] * (one - u) + slope[y1, x1, 0] * u) * v
    rise_y = (slope[y0, x0, 1] * (one - u) + slope[y0, x1, 1] * u) * (one - v)
    rise_y += (slope[y1, x0, 1] * (one - u) + slope[y1, x1, 1] * u) * v
    return rise_x, rise_y


@lane_loop
def survey(w: np.ndarray, carry: np.ndarray, seen: np.ndarray, ground: Ground, raster: Raster) -> None:
    """Normals and codes under the wheels into the workspace, layers of the cost into `seen`."""
    ny, nx, size = ground.codes.shape
    rows, columns, _ = raster.layers.shape
    quarter, zero, one = f4(0.25), f4(0), f4(1)
    for i in range(LANES):
        seen[COS * LANES + i] = cos(carry[2 * LANES + i])
        seen[SIN * LANES + i] = sin(carry[2 * LANES + i])
    for i in range(LANES):
        px, py, c, s = carry[i], carry[LANES + i], seen[COS * LANES + i], seen[SIN * LANES + i]
        normal_x, normal_y, normal_z, hazard, limit = zero, zero, zero, zero, f4(np.inf)
        for k in range(4):
            wx, wy = ground.wheels[k, 0], ground.wheels[k, 1]
            place_x, place_y = px + c * wx - s * wy, py + s * wx + c * wy

            x, y, inside = cell_at(ground.grid, nx, ny, place_x, place_y)
            codes = ground.codes[np.int64(np.rint(y)), np.int64(np.rint(x))] if inside else ground.missing
            for e in range(size):
                w[(CODES + k * size + e) * LANES + i] = codes[e]
            rise_x, rise_y = rise_at(ground.slope, x, y)
            known = inside and rise_x - rise_x == zero and rise_y - rise_y == zero
            rise_x, rise_y = (rise_x, rise_y) if known else (zero, zero)
            up = quarter / np.sqrt(one + rise_x * rise_x + rise_y * rise_y)
            normal_x, normal_y, normal_z = normal_x - rise_x * up, normal_y - rise_y * up, normal_z + up

            x, y, inside = cell_at(raster.grid, columns, rows, place_x, place_y)
            if inside:
                layers = raster.layers[np.int64(np.rint(y)), np.int64(np.rint(x))]
                hazard += quarter * layers[0]
                limit = layers[1] if layers[1] < limit else limit
            else:
                hazard += quarter * raster.outside
        w[NORMAL_ROW * LANES + i] = normal_x
        w[(NORMAL_ROW + 1) * LANES + i] = normal_y
        w[(NORMAL_ROW + 2) * LANES + i] = normal_z

        x, y, inside = cell_at(raster.grid, columns, rows, px, py)
        layers = raster.layers[np.int64(np.rint(y)), np.int64(np.rint(x))]
        seen[HAZARD * LANES + i], seen[LIMIT * LANES + i] = hazard, limit
        seen[DISTANCE * LANES + i] = layers[2] + (px - px) + (py - py)
        for k in range(ALONG_X, TARGET + 1):
            seen[k * LANES + i] = layers[k]


@lane_loop
def price(
    w: np.ndarray, before: np.ndarray, after: np.ndarray, seen: np.ndarray, prices: Prices, total: np.ndarray
) -> None:
    """Add what the states after a step cost; `survey` has looked at them."""
    for i in range(LANES):
        c, s = seen[COS * LANES + i], seen[SIN * LANES + i]
        vx, vy, yaw_rate = after[3 * LANES + i], after[4 * LANES + i], after[5 * LANES + i]
        direction = seen[ALONG_X * LANES + i], seen[ALONG_Y * LANES + i]
        acceleration = (vy - before[4 * LANES + i]) / prices.dt + vx * yaw_rate
        normal_y = c * w[(NORMAL_ROW + 1) * LANES + i] - s * w[NORMAL_ROW * LANES + i]
        normal_z = w[(NORMAL_ROW + 2) * LANES + i]
        ratio = lateral_ratio(acceleration, normal_y, normal_z, prices.gravity, prices.least_vertical, maximum)
        cost = path_term(seen[DISTANCE * LANES + i], prices.path)
        cost += speed_term((c, s), vx, vy, direction, seen[TARGET * LANES + i], prices.speed)
        cost += overspeed_term(vx, seen[LIMIT * LANES + i], prices.overspeed, maximum)
        cost += seen[HAZARD * LANES + i]
        cost += rollover_term(ratio, prices.lateral_limit, prices.rollover, maximum)
        total[i] += prices.dt * cost


@lane_loop
def command(
    w: np.ndarray, controls: np.ndarray, last: np.ndarray, recorded: np.ndarray, block: int, t: int, prices: Prices,
    total: np.ndarray,
) -> None:  # fmt: skip
    """Controls of step t into the workspace, and what they cost; lanes behind the samples repeat the last one."""
    for i in range(LANES):
        sample = min(block * LANES + i, len(controls) - 1)
        for k in range(3):
            control = controls[sample, t, k]
            before = controls[sample, t - 1, k] if t > 0 else last[k]
            cost = effort_term(control, prices.effort[k]) + jerk_term(control, before, prices.dt, prices.jerk[k])
            total[i] += prices.dt * cost
            if recorded[4 + k]:
                w[(CONTROL_ROW + k) * LANES + i] = control


def planning_entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """`entry`, compiled anew when a source of this package changes."""
    function = inspect.unwrap(function)
    files = sorted(Path(__file__).parent.glob("*.py"))
    function.__qualname__ += f"_{hashlib.sha256(b''.join(file.read_bytes() for file in files)).hexdigest()[:16]}"
    return entry(function)


@planning_entry
def roll_out(
    first: int,
    last: int,
    start: np.ndarray,
    controls: np.ndarray,
    control: np.ndarray,
    recorded: np.ndarray,
    c: np.ndarray,
    networks: Networks,
    ground: Ground,
    raster: Raster,
    prices: Prices,
    costs: np.ndarray,
    states: np.ndarray,
) -> None:
    """Roll blocks `first` ... `last - 1` out.

    Args:
        start: packed carry [P].
        controls: [K, T, 3].
        control: in the step before the first [3].
        recorded: are actuators (4) and controls (3) there?
        c: the constants (`layout.CONSTANTS`).
        networks: of the forces, the brake and the steering.
        ground, raster, prices: see there.
        costs: to fill [K].
        states: to fill [K, T, 6], or empty.
    """
    samples, steps, _ = controls.shape
    w = np.zeros((CODES + 4 * ground.codes.shape[2]) * LANES, f4)
    scratches = make_scratches(networks, f4(1))
    carries = np.zeros((2, len(start) * LANES), f4)
    seen, total = np.zeros(8 * LANES, f4), np.zeros(LANES, f4)
    for block in range(first, last):
        total[:] = f4(0)
        for k in range(len(start)):
            absent = STATES <= k < MOVED // LANES and not recorded[k - STATES]
            carries[0, k * LANES : (k + 1) * LANES] = f4(0) if absent else start[k]
        survey(w, carries[0], seen, ground, raster)
        for t in range(steps):
            before, after = carries[t % 2], carries[(t + 1) % 2]
            command(w, controls, control, recorded, block, t, prices, total)
            advance_block(w, c, networks, scratches, before, after)
            survey(w, after, seen, ground, raster)
            price(w, before, after, seen, prices, total)
            if len(states) > 0:
                for i in range(min(LANES, samples - block * LANES)):
                    for k in range(STATES):
                        states[block * LANES + i, t, k] = after[k * LANES + i]
        for i in range(min(LANES, samples - block * LANES)):
            costs[block * LANES + i] = total[i]
