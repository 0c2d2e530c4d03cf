"""Layers as the kernel reads them, four at a time, against one by one."""

import numba
import numpy as np
import pytest

from offpiste.dynamics.kernels.layout import LANES
from offpiste.planning.kernel_costs import _function, _read_layers
from offpiste.planning.kernel_terrain import FIRST_LAYER, POSE_POINT, CostCells, Grid

READS = ("mean of wheels", "least of wheels", "pose point")
CELLS = 50


@pytest.mark.parametrize("count", [1, 4, 11])
def test_layers_are_read_as_one_by_one(count):
    draw = np.random.default_rng(count)
    table = tuple((f"layer {i}", READS[draw.integers(3)], bool(draw.integers(2))) for i in range(count))
    width = max(count, 4)
    layers, outside = (draw.normal(size=size).astype(np.float32) for size in ((CELLS, width), width))
    grid = Grid(np.zeros(2, np.float32), np.float32(1), 1, CELLS)
    cells = CostCells(grid, layers.reshape(-1), outside)
    nearest = draw.integers(0, CELLS, (POSE_POINT + 1, LANES)).astype(np.int32)
    inside = draw.random(nearest.shape) > 0.3
    read_layers = _function(_read_layers(table), "read_layers", {})

    @numba.njit
    def read(k, cells, found, index, read, values):
        read_layers(k, cells, found, index, read, values)

    values, buffer = np.zeros((FIRST_LAYER + count) * LANES, np.float32), np.zeros(8 * LANES, np.float32)
    for k, found in enumerate(np.where(inside, nearest, -1 - nearest).astype(np.int32)):
        read(k, cells, found, np.zeros(LANES, np.int32), buffer, values)
    for row, (_, how, border) in enumerate(table):
        numbers = np.where(inside | border, layers[nearest, row], outside[row])
        wanted = {
            "mean of wheels": numbers[:POSE_POINT].mean(axis=0),
            "least of wheels": numbers[:POSE_POINT].min(axis=0),
            "pose point": numbers[POSE_POINT],
        }[how]
        np.testing.assert_allclose(values.reshape(-1, LANES)[FIRST_LAYER + row], wanted, rtol=1e-5, atol=1e-6)
