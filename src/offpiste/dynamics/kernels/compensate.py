"""One step of a compensator network on a block, and its adjoint: generated loops between matrix products."""

from typing import NamedTuple

import numpy as np

from offpiste.dynamics.kernels.elementary import Lane, f4, tanh
from offpiste.dynamics.kernels.generated import cell, cell_adjoint
from offpiste.dynamics.kernels.jit import lane_loop, maker
from offpiste.dynamics.kernels.layout import CELL_ROW, CELL_ROWS, HIDDEN, LANES
from offpiste.dynamics.kernels.matrix import add_outer, add_product, copy
from offpiste.dynamics.kernels.network import Network

UNITS = HIDDEN * LANES
GATES = 4 * UNITS
MEMORY = CELL_ROW["memory"] * UNITS
NEXT_HIDDEN = CELL_ROW["next_hidden"] * UNITS
NEXT_MEMORY = CELL_ROW["next_memory"] * UNITS
CELL = len(CELL_ROWS) * UNITS


class Scratch(NamedTuple):
    """What a network computes in one step, as rows of lanes.

    Attributes:
        seen: hidden before, standardised inputs, 1, padding, hidden after.
        cell: workspace of the LSTM cell (`layout.CELL_ROWS`).
        layer: hidden layer, padding, 1, padding.
    """

    seen: np.ndarray
    cell: np.ndarray
    layer: np.ndarray


@maker
def make_scratch(network: Network, one: Lane) -> Scratch:
    """Scratch of a network; `one` stands in the row of the biases' input, 0 for adjoints."""
    seen = np.zeros((network.gates.shape[1] + HIDDEN) * LANES, f4)
    layer = np.zeros(network.outer.shape[1] * LANES, f4)
    if network.outer.shape[0] > 0:
        bias = (HIDDEN + len(network.inputs)) * LANES
        seen[bias : bias + LANES] = one
        bias = network.inner.shape[0] * LANES
        layer[bias : bias + LANES] = one
    return Scratch(seen, np.zeros(CELL, f4), layer)


@lane_loop
def compensate(network: Network, s: Scratch, w: np.ndarray, before: np.ndarray, after: np.ndarray, units: int) -> None:
    """One step of a network: its outputs into the workspace, its recurrent state from one carry to the next.

    Args:
        before, after: hidden units of all networks, then their cells.
        units: how many units all networks have.
    """
    if network.outer.shape[0] == 0:
        return
    inputs = HIDDEN * LANES
    hidden = network.first_hidden * LANES
    memory = hidden + units * LANES
    copy(before[hidden : hidden + UNITS], s.seen[:inputs])
    for k in range(len(network.inputs)):
        row = w[network.inputs[k] * LANES : (network.inputs[k] + 1) * LANES]
        standardised = s.seen[inputs + k * LANES : inputs + (k + 1) * LANES]
        mean, scale = network.mean[k], network.inverse_scale[k]
        for i in range(LANES):
            standardised[i] = (row[i] - mean) * scale

    s.cell[:GATES] = f4(0)
    add_product(network.gates, s.seen, s.cell)
    copy(before[memory : memory + UNITS], s.cell[MEMORY : MEMORY + UNITS])
    cell(s.cell)
    copy(s.cell[NEXT_HIDDEN : NEXT_HIDDEN + UNITS], after[hidden : hidden + UNITS])
    copy(s.cell[NEXT_MEMORY : NEXT_MEMORY + UNITS], after[memory : memory + UNITS])

    copy(s.cell[NEXT_HIDDEN : NEXT_HIDDEN + UNITS], s.seen[len(s.seen) - UNITS :])
    width = network.inner.shape[0] * LANES
    s.layer[:width] = f4(0)
    add_product(network.inner, s.seen[inputs:], s.layer)
    for i in range(width):
        s.layer[i] = tanh(s.layer[i])
    out = w[network.first_output * LANES : (network.first_output + network.outer.shape[0]) * LANES]
    out[:] = f4(0)
    add_product(network.outer, s.layer, out)


@lane_loop
def compensate_adjoint(
    network: Network,
    s: Scratch,
    bar: Scratch,
    w_bar: np.ndarray,
    carry_bar: np.ndarray,
    units: int,
    gates_bar: np.ndarray,
    inner_bar: np.ndarray,
    outer_bar: np.ndarray,
) -> None:
    """Back through `compensate`.

    Args:
        s: what `compensate` left.
        bar: like `s`, for the adjoints.
        w_bar: has the outputs' adjoints; those of the inputs are added.
        carry_bar: adjoint of the recurrent state after the step, replaced by the one before it.
        gates_bar, inner_bar, outer_bar: the weights' adjoints, added to; without rows where the network is frozen.
    """
    if network.outer.shape[0] == 0:
        return
    inputs = HIDDEN * LANES
    hidden = network.first_hidden * LANES
    memory = hidden + units * LANES
    after = len(s.seen) - UNITS
    out_bar = w_bar[network.first_output * LANES : (network.first_output + network.outer.shape[0]) * LANES]
    add_outer(out_bar, s.layer, outer_bar)
    bar.layer[:] = f4(0)
    add_product(network.outer_t, out_bar, bar.layer)
    for i in range(network.inner.shape[0] * LANES):
        bar.layer[i] *= f4(1) - s.layer[i] * s.layer[i]

    add_outer(bar.layer, s.seen[inputs:], inner_bar)
    bar.seen[:] = f4(0)
    add_product(network.inner_t, bar.layer, bar.seen[inputs:])

    bar.cell[:NEXT_HIDDEN] = f4(0)
    for i in range(UNITS):
        bar.cell[NEXT_HIDDEN + i] = carry_bar[hidden + i] + bar.seen[after + i]
    copy(carry_bar[memory : memory + UNITS], bar.cell[NEXT_MEMORY : NEXT_MEMORY + UNITS])
    cell_adjoint(s.cell, bar.cell)
    add_outer(bar.cell, s.seen, gates_bar)
    add_product(network.gates_t, bar.cell, bar.seen)

    copy(bar.seen[:inputs], carry_bar[hidden : hidden + UNITS])
    copy(bar.cell[MEMORY : MEMORY + UNITS], carry_bar[memory : memory + UNITS])
    for k in range(len(network.inputs)):
        row = w_bar[network.inputs[k] * LANES : (network.inputs[k] + 1) * LANES]
        standardised = bar.seen[inputs + k * LANES : inputs + (k + 1) * LANES]
        scale = network.inverse_scale[k]
        for i in range(LANES):
            row[i] += standardised[i] * scale
