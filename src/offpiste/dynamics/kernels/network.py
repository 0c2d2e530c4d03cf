"""One step of a compensator network on a block of lanes, and its adjoint: generated loops between matrix products.

Weights have their biases as columns and are padded to multiples of four, as the matrix products take them.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import pad

from offpiste.dynamics.kernels.elementary import Lane, add_outer, add_product, copy, copy_or_zero, f4, tanh
from offpiste.dynamics.kernels.generated import cell, cell_adjoint
from offpiste.dynamics.kernels.layout import CELL_ROW, CELL_ROWS, HIDDEN, LANES
from offpiste.dynamics.kernels.vectors import WIDTH, clamp, load, store
from offpiste.dynamics.lstm import FADE, LSTM, Compensator
from offpiste.native.compilation import KERNELS


class Weights(NamedTuple):
    """Three matrices, without rows and columns where there is no network; one row of their input is always 1.

    Attributes:
        gates: of the LSTM cell, on (hidden before, inputs, 1, padding).
        inner: of the hidden layer, on (inputs, 1, padding, hidden after).
        outer: of the output layer, on (hidden layer, padding, 1, padding).
    """

    gates: Float[Tensor, "G M"]
    inner: Float[Tensor, "N M"]
    outer: Float[Tensor, "O K"]


class Network(NamedTuple):
    """The same for Numba, with all that does not learn here.

    Attributes:
        inputs: rows of the workspace that the network sees.
        terms: rows that are added to gates and hidden layer from elsewhere (`Buffers.terms`); 0: none are.
        mean, inverse_scale: that these are standardised with.
        low, high: range of each, standardised.
        gates, inner, outer: see `Weights`.
        gates_t, inner_t, outer_t: their transposes.
        first_hidden: its first hidden unit among those of all networks.
        first_output: row of the workspace that its outputs begin at.
    """

    inputs: np.ndarray
    terms: int
    mean: np.ndarray
    inverse_scale: np.ndarray
    low: np.ndarray
    high: np.ndarray
    gates: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    gates_t: np.ndarray
    inner_t: np.ndarray
    outer_t: np.ndarray
    first_hidden: int
    first_output: int


def weights(compensator: Compensator | None, scale: Tensor | None = None, *, apart: int = 0) -> Weights:
    """Weights as `Weights`, differentiable.

    Args:
        compensator: or None, for no network.
        scale: factors of the outputs.
        apart: number of inputs, the last ones, that `weights_apart` has instead.
    """
    if compensator is None:
        return Weights(*(torch.zeros(0, 0, dtype=torch.float32) for _ in Weights._fields))
    cell = compensator.cell
    assert isinstance(cell, LSTM)
    first, last = (layer for layer in compensator.output.children() if isinstance(layer, nn.Linear))
    seen = cell.input_size - apart
    from_hidden, from_inputs, _ = first.weight.split((HIDDEN, seen, apart), dim=1)
    inner = torch.cat((from_inputs, first.bias[:, None]), dim=1)
    outer = torch.cat((pad(last.weight, (0, -last.in_features % 4)), last.bias[:, None]), dim=1)
    return Weights(
        gates=_pad(torch.cat((cell.weight_hh, cell.weight_ih[:, :seen], (cell.bias_ih + cell.bias_hh)[:, None]), 1)),
        inner=torch.cat((_pad(inner), _pad(from_hidden)), dim=1),
        outer=_pad(outer if scale is None else scale[:, None] * outer),
    )


def weights_apart(compensator: Compensator, apart: int) -> Float[Tensor, "N I"]:
    """Weights of gates, then hidden layer, on the last `apart` inputs, differentiable; padded rows as `weights`."""
    first = next(layer for layer in compensator.output.children() if isinstance(layer, nn.Linear))
    assert isinstance(compensator.cell, LSTM)
    parts = (matrix[:, -apart:] for matrix in (compensator.cell.weight_ih, first.weight))
    return torch.cat([pad(part, (0, 0, 0, -len(part) % 4)) for part in parts])


def network(
    compensator: Compensator | None,
    weights: Weights,
    *,
    inputs: list[int],
    first_hidden: int,
    first_output: int,
    terms: int = 0,
) -> Network:
    """What the kernels read.

    Args:
        compensator: or None, for no network.
        weights: from `weights`.
        inputs, first_hidden, first_output, terms: see `Network`.
    """
    nothing, count = torch.zeros(0, dtype=torch.float32), len(inputs)
    return Network(
        inputs=np.array(inputs, dtype=np.int64),
        terms=terms,
        mean=(nothing if compensator is None else compensator.mean[:count]).numpy(),
        inverse_scale=(nothing if compensator is None else 1 / compensator.scale[:count]).numpy(),
        low=(nothing if compensator is None else compensator.low[:count]).numpy(),
        high=(nothing if compensator is None else compensator.high[:count]).numpy(),
        gates=_array(weights.gates),
        inner=_array(weights.inner),
        outer=_array(weights.outer),
        gates_t=_array(weights.gates.t()),
        inner_t=_array(weights.inner.t()),
        outer_t=_array(weights.outer.t()),
        first_hidden=first_hidden,
        first_output=first_output,
    )


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def _pad(matrix: Tensor) -> Tensor:
    return pad(matrix, (0, -matrix.shape[1] % 4, 0, -matrix.shape[0] % 4))


UNITS = HIDDEN * LANES
GATES = 4 * UNITS
MEMORY = CELL_ROW["memory"] * UNITS
NEXT_HIDDEN = CELL_ROW["next_hidden"] * UNITS
NEXT_MEMORY = CELL_ROW["next_memory"] * UNITS
CELL = len(CELL_ROWS) * UNITS


class Buffers(NamedTuple):
    """What a network computes in one step, as rows of lanes.

    Attributes:
        seen: hidden before, standardised inputs within their ranges, 1, padding, hidden after.
        cell: workspace of the LSTM cell (`layout.CELL_ROWS`).
        layer: hidden layer, padding, 1, padding.
        trust: factor of the outputs, 1 while the inputs are within their ranges.
        terms: what is added to the gates, then to the hidden layer, from elsewhere; empty where nothing is.
    """

    seen: np.ndarray
    cell: np.ndarray
    layer: np.ndarray
    trust: np.ndarray
    terms: np.ndarray


@KERNELS.maker
def make_buffers(network: Network, one: Lane) -> Buffers:
    """Buffers of a network; `one` stands in the row of the biases' input, 0 for adjoints."""
    seen = np.zeros((network.gates.shape[1] + HIDDEN) * LANES, f4)
    layer = np.zeros(network.outer.shape[1] * LANES, f4)
    if network.outer.shape[0] > 0:
        bias = (HIDDEN + len(network.inputs)) * LANES
        seen[bias : bias + LANES] = one
        bias = network.inner.shape[0] * LANES
        layer[bias : bias + LANES] = one
    return Buffers(seen, np.zeros(CELL, f4), layer, np.zeros(LANES, f4), np.zeros(network.terms * LANES, f4))


@KERNELS.inlined
def standardise(network: Network, w: np.ndarray, standardised: np.ndarray, trust: np.ndarray) -> None:
    """Bring a network's inputs into their ranges; trust is the smaller the further they were outside."""
    zero, one = f4(0), f4(1)
    for i in range(0, LANES, WIDTH):
        beyond = zero
        for k in range(len(network.inputs)):
            z = (load(w, network.inputs[k] * LANES + i) - network.mean[k]) * network.inverse_scale[k]
            within = clamp(z, network.low[k], network.high[k])
            beyond += (z - within) * (z - within)
            store(standardised, k * LANES + i, within)
        store(trust, i, one / (one + f4(FADE) * beyond))


@KERNELS.inlined
def compensate(network: Network, s: Buffers, w: np.ndarray, before: np.ndarray, after: np.ndarray, units: int) -> None:
    """One step of a network: its outputs into the workspace, its recurrent state from one model state to the next.

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
    standardise(network, w, s.seen[inputs:], s.trust)

    copy_or_zero(s.terms[:GATES], s.cell[:GATES])
    add_product(network.gates, s.seen, s.cell)
    copy(before[memory : memory + UNITS], s.cell[MEMORY : MEMORY + UNITS])
    cell(s.cell)
    copy(s.cell[NEXT_HIDDEN : NEXT_HIDDEN + UNITS], after[hidden : hidden + UNITS])
    copy(s.cell[NEXT_MEMORY : NEXT_MEMORY + UNITS], after[memory : memory + UNITS])

    copy(s.cell[NEXT_HIDDEN : NEXT_HIDDEN + UNITS], s.seen[len(s.seen) - UNITS :])
    width = network.inner.shape[0] * LANES
    copy_or_zero(s.terms[GATES:], s.layer[:width])
    add_product(network.inner, s.seen[inputs:], s.layer)
    for i in range(width):
        s.layer[i] = tanh(s.layer[i])
    out = w[network.first_output * LANES : (network.first_output + network.outer.shape[0]) * LANES]
    out[:] = f4(0)
    add_product(network.outer, s.layer, out)
    for k in range(network.outer.shape[0]):
        for i in range(LANES):
            out[k * LANES + i] *= s.trust[i]


@KERNELS.loop
def compensate_adjoint(
    network: Network,
    s: Buffers,
    bar: Buffers,
    w: np.ndarray,
    w_bar: np.ndarray,
    model_state_bar: np.ndarray,
    units: int,
    gates_bar: np.ndarray,
    inner_bar: np.ndarray,
    outer_bar: np.ndarray,
) -> None:
    """Back through `compensate`.

    Args:
        s: what `compensate` left.
        bar: like `s`, for the adjoints; its `trust` is that of the trust's logarithm.
        w: has the inputs and the outputs.
        w_bar: has the outputs' adjoints; those of the inputs are added.
        model_state_bar: adjoint of the recurrent state after the step, replaced by the one before it.
        gates_bar, inner_bar, outer_bar: the weights' adjoints, added to; without rows where the network is frozen.
    """
    if network.outer.shape[0] == 0:
        return
    inputs = HIDDEN * LANES
    hidden = network.first_hidden * LANES
    memory = hidden + units * LANES
    after = len(s.seen) - UNITS
    out = w[network.first_output * LANES : (network.first_output + network.outer.shape[0]) * LANES]
    out_bar = w_bar[network.first_output * LANES : (network.first_output + network.outer.shape[0]) * LANES]
    bar.trust[:] = f4(0)
    for k in range(network.outer.shape[0]):
        for i in range(LANES):
            bar.trust[i] += out_bar[k * LANES + i] * out[k * LANES + i]
            out_bar[k * LANES + i] *= s.trust[i]
    add_outer(out_bar, s.layer, outer_bar)
    bar.layer[:] = f4(0)
    add_product(network.outer_t, out_bar, bar.layer)
    for i in range(network.inner.shape[0] * LANES):
        bar.layer[i] *= f4(1) - s.layer[i] * s.layer[i]

    copy(bar.layer, bar.terms[GATES:])
    add_outer(bar.layer, s.seen[inputs:], inner_bar)
    bar.seen[:] = f4(0)
    add_product(network.inner_t, bar.layer, bar.seen[inputs:])

    bar.cell[:NEXT_HIDDEN] = f4(0)
    for i in range(UNITS):
        bar.cell[NEXT_HIDDEN + i] = model_state_bar[hidden + i] + bar.seen[after + i]
    copy(model_state_bar[memory : memory + UNITS], bar.cell[NEXT_MEMORY : NEXT_MEMORY + UNITS])
    cell_adjoint(s.cell, bar.cell)
    copy(bar.cell, bar.terms[:GATES])
    add_outer(bar.cell, s.seen, gates_bar)
    add_product(network.gates_t, bar.cell, bar.seen)

    copy(bar.seen[:inputs], model_state_bar[hidden : hidden + UNITS])
    copy(bar.cell[MEMORY : MEMORY + UNITS], model_state_bar[memory : memory + UNITS])
    for k in range(len(network.inputs)):
        row = w[network.inputs[k] * LANES : (network.inputs[k] + 1) * LANES]
        row_bar = w_bar[network.inputs[k] * LANES : (network.inputs[k] + 1) * LANES]
        seen_bar = bar.seen[inputs + k * LANES : inputs + (k + 1) * LANES]
        mean, scale, low, high = network.mean[k], network.inverse_scale[k], network.low[k], network.high[k]
        for i in range(LANES):
            z = (row[i] - mean) * scale
            beyond = z - min(max(z, low), high)
            within = seen_bar[i] if beyond == f4(0) else f4(0)
            row_bar[i] += (within - f4(2 * FADE) * beyond * s.trust[i] * bar.trust[i]) * scale
