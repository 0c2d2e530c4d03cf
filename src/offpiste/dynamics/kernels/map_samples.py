"""What a block of lanes reads of the maps under its wheels: the slope of the ground, and the features of cells."""

from typing import Final, NamedTuple

import numpy as np

from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.elementary import Lane, cos, f4, sin
from offpiste.dynamics.kernels.encoder import Layers
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.rollout import NORMAL_ROW, UNKNOWN_ROW
from offpiste.mapping import terrain_map
from offpiste.native.compilation import KERNELS

WHEELS: Final = 4
YAW: Final = layout.ROW["yaw"]

on_map = KERNELS.inlined(terrain_map.on_map)
bilinear = KERNELS.inlined(terrain_map.bilinear)
wheel_position = KERNELS.inlined(terrain_map.wheel_position)


class Ground(NamedTuple):
    """Maps as the kernel reads them.

    Attributes:
        shift: from each window's frame to cell [0, 0] of its map [B, 2] [m].
        number: of the map of each window [B].
        resolution: [m].
        wheels: in the body frame [4, 2] [m].
        last, place: see `CellStack` [S, 2], [S, ny, nx].
        slope: of the cells, float16 as bits [C, 2].
        features: alike [C, F].
    """

    shift: np.ndarray
    number: np.ndarray
    resolution: Lane
    wheels: np.ndarray
    last: np.ndarray
    place: np.ndarray
    slope: np.ndarray
    features: np.ndarray


class Samples(NamedTuple):
    """What a block reads at the cells under its wheels: of wheel k and lane i in row k * LANES + i.

    Attributes:
        features, bits: [4 * LANES, F], as numbers and as the same memory's bits.
        valid: whether there are features [4 * LANES].
        slope, slope_bits: of the four cells around one wheel [8], alike.
    """

    features: np.ndarray
    bits: np.ndarray
    valid: np.ndarray
    slope: np.ndarray
    slope_bits: np.ndarray


@KERNELS.maker
def make_samples(layers: Layers) -> Samples:
    """Samples of a block."""
    features, slope = np.zeros((WHEELS * LANES, len(layers.mean)), f4), np.zeros(8, f4)
    valid = np.zeros(WHEELS * LANES, np.bool_)
    return Samples(features, features.view(np.uint32), valid, slope, slope.view(np.uint32))


SCALE: Final = f4(2.0**112)
"""Factor of numbers that `_widened` gives."""


@KERNELS.inlined
def _widened(half: Lane) -> Lane:
    """Bits of a float16 as those of the float32 times 2^-112; what is not finite becomes not a number.

    Subnormal numbers come out right, too.
    """
    bits = np.uint32(half)
    sign, rest = (bits & np.uint32(0x8000)) << np.uint32(16), bits & np.uint32(0x7FFF)
    return sign | (np.uint32(0x7FC00000) if rest >= np.uint32(0x7C00) else rest << np.uint32(13))


@KERNELS.loop
def _read_slope(ground: Ground, s: Samples, number: int, x: Lane, y: Lane) -> tuple[Lane, Lane]:
    """Slope between the four cells around a place on the map, in cells; NaN where it is unknown."""
    column, row = ground.last[number, 0], ground.last[number, 1]
    x0, y0 = min(int(x), max(column - 1, 0)), min(int(y), max(row - 1, 0))
    x1, y1 = min(x0 + 1, column), min(y0 + 1, row)
    for n in range(4):
        cell = ground.place[number, y1 if n >= 2 else y0, x1 if n % 2 else x0]
        cell = cell if cell >= 0 else len(ground.slope) - 1
        for k in range(2):
            s.slope_bits[2 * n + k] = _widened(ground.slope[cell, k])
    for n in range(8):
        s.slope[n] *= SCALE
    u, v, one, a = x - f4(x0), y - f4(y0), f4(1), s.slope
    return bilinear(a[0], a[2], a[4], a[6], u, v, one), bilinear(a[1], a[3], a[5], a[7], u, v, one)


@KERNELS.loop
def _read_features(ground: Ground, s: Samples, row: int, cell: int) -> None:
    """Features of a cell into a row of the samples, and whether all are there."""
    valid = cell >= 0
    if valid:
        for k in range(s.features.shape[1]):
            s.bits[row, k] = _widened(ground.features[cell, k])
        for k in range(s.features.shape[1]):
            s.features[row, k] *= SCALE
        for k in range(ground.features.shape[1]):  # also of those that the model does not read
            valid &= (ground.features[cell, k] & np.uint16(0x7FFF)) < np.uint16(0x7C00)
    s.valid[row] = valid


@KERNELS.loop
def sample_ground(w: np.ndarray, before: np.ndarray, ground: Ground, s: Samples, block: int, reads: bool) -> None:
    """Mean normals and unknown ones under a block into the workspace, features into the samples, as `sample_maps`."""
    w[NORMAL_ROW * LANES : (NORMAL_ROW + 3) * LANES] = f4(0)
    w[UNKNOWN_ROW * LANES : (UNKNOWN_ROW + 1) * LANES] = f4(0)
    zero, quarter = f4(0), f4(0.25)
    for i in range(LANES):
        window = min(block * LANES + i, len(ground.number) - 1)
        yaw, number = before[YAW * LANES + i], ground.number[window]
        c, s_ = cos(yaw), sin(yaw)
        last_x, last_y = f4(ground.last[number, 0]), f4(ground.last[number, 1])
        for k in range(WHEELS):
            px, py = wheel_position(before[i], before[LANES + i], c, s_, ground.wheels[k, 0], ground.wheels[k, 1])
            x = (px + ground.shift[window, 0]) / ground.resolution
            y = (py + ground.shift[window, 1]) / ground.resolution
            rise_x, rise_y, cell = f4(np.nan), f4(np.nan), np.int32(-1)
            if on_map(x, y, last_x, last_y, f4(0.5)):
                x, y = min(max(x, zero), last_x), min(max(y, zero), last_y)
                cell = ground.place[number, int(np.rint(y)), int(np.rint(x))]
                rise_x, rise_y = _read_slope(ground, s, number, x, y)
            if np.isfinite(rise_x) and np.isfinite(rise_y):
                up = quarter / np.sqrt(f4(1) + rise_x * rise_x + rise_y * rise_y)
                w[NORMAL_ROW * LANES + i] -= rise_x * up
                w[(NORMAL_ROW + 1) * LANES + i] -= rise_y * up
                w[(NORMAL_ROW + 2) * LANES + i] += up
            else:
                w[(NORMAL_ROW + 2) * LANES + i] += quarter
                w[UNKNOWN_ROW * LANES + i] += quarter
            if reads:
                _read_features(ground, s, k * LANES + i, cell)
