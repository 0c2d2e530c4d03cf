"""The recurrent network that compensates what physics leaves: an LSTM whose state is set from the recent past."""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor, nn

RANGE: Final = (0.005, 0.995)
"""Quantiles of the training rows between which lies the range of an input that has one."""

FADE: Final = 10.0
"""Outputs are divided by 1 + FADE d^2 at the distance d of the inputs from their ranges, in standard deviations."""

UNLIMITED: Final = 1e9
"""Bound of an input without a range: finite, so that a run's weights can be checked."""


class Compensator(nn.Module):
    """zeta of eq. 5: LSTM (hidden 4) and output network (20 units), started by an init LSTM (hidden 20).

    The output network sees the LSTM's hidden state and its inputs. Its last layer starts at zero, so that an untrained
    compensator leaves the physics as it is.

    Where inputs leave their range in training, the network sees the range's end, and its outputs fade.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        hidden: int = 4,
        width: int = 20,
        init_hidden: int = 20,
        init_width: int = 20,
    ) -> None:
        super().__init__()
        self.hidden = hidden
        self.cell = nn.LSTMCell(inputs, hidden)
        last = nn.Linear(width, outputs)
        self.output = nn.Sequential(nn.Linear(hidden + inputs, width), nn.Tanh(), last)
        self.init_cell = nn.LSTM(inputs, init_hidden, batch_first=True)
        self.init_output = nn.Sequential(
            nn.Linear(init_hidden, init_width), nn.Tanh(), nn.Linear(init_width, 2 * hidden)
        )
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
        """Take mean and scale from training inputs; one that hardly varies keeps its unit.

        Args:
            shares: inputs from 0 to 1, which stay as they are: one that is rare in training may be common later.
            ranged: number of inputs, the first ones, that have a range unless they are shares.
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

    def start(self, inputs: Float[Tensor, "B H I"]) -> tuple[Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """Hidden and cell state from the inputs of the history."""
        _, (last, _) = self.init_cell(self._standardised(inputs).clamp(self.low, self.high))
        hidden, cell = self.init_output(last[0]).chunk(2, dim=-1)
        return torch.tanh(hidden), cell

    def forward(
        self, inputs: Float[Tensor, "B I"], hidden: Float[Tensor, "B S"], cell: Float[Tensor, "B S"]
    ) -> tuple[Float[Tensor, "B O"], Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """One step: compensation, next hidden state, next cell state."""
        standardised = self._standardised(inputs)
        seen = standardised.clamp(self.low, self.high)
        trust = 1 / (1 + FADE * (standardised - seen).square().sum(dim=-1, keepdim=True))
        hidden, cell = self.cell(seen, (hidden, cell))
        return self.output(torch.cat((hidden, seen), dim=-1)) * trust, hidden, cell
