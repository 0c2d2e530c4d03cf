"""Network that corrects the physics: a recurrent cell whose state is initialised from the recent past."""

from collections.abc import Callable
from typing import Final, Protocol

import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.core.conventions import FADE

RANGE: Final = (0.005, 0.995)
"""Quantiles of the training inputs that bound the range of an input."""

UNLIMITED: Final = 1e9
"""Bound of an input without a range; finite, because the weights of a run are checked for infinities."""


WIDTH: Final = 20
"""Units of the hidden layers, and of the LSTM that reads the recent past."""


class Cell(Protocol):
    """Module that steps a recurrent state with a layout known only to itself.

    Attributes:
        state_size: length S of the state.
    """

    state_size: int

    def initial(self, raw: Float[Tensor, "B S"]) -> Float[Tensor, "B S"]:
        """Return the initial state from unbounded outputs of a network."""

    def advance(self, inputs: Float[Tensor, "B I"], state: Float[Tensor, "B S"]) -> tuple[Tensor, Tensor]:
        """Return the hidden units [B, H], which the output network reads, and the next state [B, S]."""


class LSTM(nn.LSTMCell):
    """LSTM cell; its state is the hidden units, then the cells."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__(inputs, hidden)
        self.state_size = 2 * hidden

    def initial(self, raw: Float[Tensor, "B S"]) -> Float[Tensor, "B S"]:
        """Bound the hidden units by tanh."""
        hidden, cell = raw.chunk(2, dim=-1)
        return torch.cat((torch.tanh(hidden), cell), dim=-1)

    def advance(self, inputs: Float[Tensor, "B I"], state: Float[Tensor, "B S"]) -> tuple[Tensor, Tensor]:
        """Return the hidden units and the next state."""
        hidden, cell = self(inputs, state.chunk(2, dim=-1))
        return hidden, torch.cat((hidden, cell), dim=-1)


class Compensator(nn.Module):
    """Correction zeta of eq. 5: recurrent cell (4 units) and output network (20), initialised by an LSTM (20).

    The output network reads the cell's hidden units and the inputs. Its last layer starts at zero, so that an untrained
    compensator leaves the physics unchanged. Inputs beyond their range in training are clamped, and the outputs fade.

    Args:
        cell: constructor of the recurrent cell from the numbers of inputs and hidden units.
        hidden: number of hidden units of the cell.
    """

    cell: Cell

    def __init__(self, inputs: int, outputs: int, *, cell: Callable[[int, int], Cell] = LSTM, hidden: int = 4) -> None:
        super().__init__()
        self.cell = cell(inputs, hidden)
        self.state_size = self.cell.state_size
        last = nn.Linear(WIDTH, outputs)
        self.output = nn.Sequential(nn.Linear(hidden + inputs, WIDTH), nn.Tanh(), last)
        self.init_cell = nn.LSTM(inputs, WIDTH, batch_first=True)
        self.init_output = nn.Sequential(nn.Linear(WIDTH, WIDTH), nn.Tanh(), nn.Linear(WIDTH, self.state_size))
        self.mean: Tensor
        self.scale: Tensor
        self.low: Tensor
        self.high: Tensor
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("scale", torch.ones(inputs))
        self.register_buffer("low", torch.full((inputs,), -UNLIMITED))
        self.register_buffer("high", torch.full((inputs,), UNLIMITED))
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def standardise_on(self, inputs: Float[Tensor, "N I"], shares: slice, *, ranged: int = 0) -> None:
        """Set mean and scale from training inputs; inputs that hardly vary keep their unit.

        Args:
            shares: inputs in [0, 1] that are not standardised: values rare in training may be common later.
            ranged: number of leading inputs that have a range, unless they are shares.
        """
        mean, scale = inputs.mean(dim=0), inputs.std(dim=0)
        mean[shares], scale[shares] = 0.0, 1.0
        self.mean.copy_(mean)
        self.scale.copy_(torch.where(scale > 1e-3, scale, torch.ones_like(scale)))
        if ranged:
            low, high = torch.quantile(self._standardised(inputs)[:, :ranged], inputs.new_tensor(RANGE), dim=0)
            self.low[:ranged], self.high[:ranged] = low, high
            self.low[shares], self.high[shares] = -UNLIMITED, UNLIMITED

    def _standardised(self, inputs: Float[Tensor, "*B I"]) -> Float[Tensor, "*B I"]:
        return (inputs - self.mean) / self.scale

    def start(self, inputs: Float[Tensor, "B H I"]) -> Float[Tensor, "B S"]:
        """Return the recurrent state after the inputs of the history."""
        _, (last, _) = self.init_cell(self._standardised(inputs).clamp(self.low, self.high))
        return self.cell.initial(self.init_output(last[0]))

    def forward(
        self, inputs: Float[Tensor, "B I"], state: Float[Tensor, "B S"]
    ) -> tuple[Float[Tensor, "B O"], Float[Tensor, "B S"]]:
        """Return the correction of one step and the next recurrent state."""
        standardised = self._standardised(inputs)
        seen = standardised.clamp(self.low, self.high)
        trust = 1 / (1 + FADE * (standardised - seen).square().sum(dim=-1, keepdim=True))
        hidden, state = self.cell.advance(seen, state)
        return self.output(torch.cat((hidden, seen), dim=-1)) * trust, state
