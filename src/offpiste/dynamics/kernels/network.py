"""A `Compensator`'s weights as the kernels want them: biases as columns, everything padded to multiples of four."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import pad

from offpiste.dynamics.kernels.layout import HIDDEN
from offpiste.dynamics.recurrent import Compensator


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
        mean, inverse_scale: that these are standardised with.
        gates, inner, outer: see `Weights`.
        gates_t, inner_t, outer_t: their transposes.
        first_hidden: its first hidden unit among those of all networks.
        first_output: row of the workspace that its outputs begin at.
    """

    inputs: np.ndarray
    mean: np.ndarray
    inverse_scale: np.ndarray
    gates: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    gates_t: np.ndarray
    inner_t: np.ndarray
    outer_t: np.ndarray
    first_hidden: int
    first_output: int


def weights(compensator: Compensator | None, scale: Tensor | None = None) -> Weights:
    """Weights as `Weights`, differentiable.

    Args:
        compensator: or None, for no network.
        scale: factors of the outputs.
    """
    if compensator is None:
        return Weights(*(torch.zeros(0, 0, dtype=torch.float32) for _ in Weights._fields))
    cell = compensator.cell
    first, last = (layer for layer in compensator.output.children() if isinstance(layer, nn.Linear))
    from_hidden, from_inputs = first.weight.split((HIDDEN, cell.input_size), dim=1)
    inner = torch.cat((from_inputs, first.bias[:, None]), dim=1)
    outer = torch.cat((pad(last.weight, (0, -last.in_features % 4)), last.bias[:, None]), dim=1)
    return Weights(
        gates=_pad(torch.cat((cell.weight_hh, cell.weight_ih, (cell.bias_ih + cell.bias_hh)[:, None]), dim=1)),
        inner=torch.cat((_pad(inner), _pad(from_hidden)), dim=1),
        outer=_pad(outer if scale is None else scale[:, None] * outer),
    )


def network(
    compensator: Compensator | None, weights: Weights, *, inputs: list[int], first_hidden: int, first_output: int
) -> Network:
    """What the kernels read.

    Args:
        compensator: or None, for no network.
        weights: from `weights`.
        inputs, first_hidden, first_output: see `Network`.
    """
    nothing = torch.zeros(0, dtype=torch.float32)
    return Network(
        inputs=np.array(inputs, dtype=np.int64),
        mean=(nothing if compensator is None else compensator.mean).numpy(),
        inverse_scale=(nothing if compensator is None else 1 / compensator.scale).numpy(),
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
