"""Model states in the order of compiled code: state, actuators, all hidden units, all cells."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.state import ModelState
from offpiste.dynamics.kernels import layout


def hidden_and_cells(recurrent: Float[Tensor, "B R"]) -> tuple[Float[Tensor, "B S"], Float[Tensor, "B S"]]:
    """Return the hidden units of all LSTMs and their cells, from the recurrent state of a model."""
    networks = recurrent.unflatten(-1, (recurrent.shape[-1] // (2 * layout.HIDDEN), 2, layout.HIDDEN))
    return networks[..., 0, :].flatten(-2), networks[..., 1, :].flatten(-2)


def to_kernel_state(model_state: ModelState) -> Float[Tensor, "B P"]:
    """Return a model state in the order of the kernels."""
    return torch.cat((model_state.state, model_state.actuators, *hidden_and_cells(model_state.recurrent)), dim=-1)


def from_kernel_state(packed: Float[Tensor, "B P"]) -> ModelState:
    """Return the model state of a row in the order of the kernels."""
    moved = ModelState.unpack(packed)
    kinds = moved.recurrent.unflatten(-1, (2, moved.recurrent.shape[-1] // (2 * layout.HIDDEN), layout.HIDDEN))
    return replace(moved, recurrent=kinds.transpose(-3, -2).flatten(-3))
