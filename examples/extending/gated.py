"""The hybrid model with a GRU in place of its LSTM.

    export PYTHONPATH=examples/extending OFFPISTE_EXTENSIONS=gated
    offpiste train dataset.zarr --out run --model b-gru

The generated kernels cover LSTMs only, so offpiste warns once and steps this model eagerly.
"""

from functools import partial

import torch
from torch import Tensor, nn

from offpiste.dynamics import Hybrid, register_model


class GRU(nn.GRUCell):
    """GRU cell; its state is its hidden units."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__(inputs, hidden)
        self.state_size = hidden

    def initial(self, raw: Tensor) -> Tensor:
        """Bound the hidden units [B, S] by tanh."""
        return torch.tanh(raw)

    def advance(self, inputs: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the hidden units and the next state, both [B, S]."""
        hidden = self(inputs, state)
        return hidden, hidden


register_model("b-gru", colour="#4d4d4d", what="b with a GRU")(partial(Hybrid, cell=GRU))
