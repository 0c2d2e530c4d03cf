"""The recurrent network that compensates what physics leaves: an LSTM whose state is set from the recent past."""

import torch
from jaxtyping import Float
from torch import Tensor, nn


class Compensator(nn.Module):
    """zeta of eq. 5: LSTM (hidden 4) and output network (20 units), started by an init LSTM (hidden 20).

    The output network sees the LSTM's hidden state and its inputs. Its last layer starts at zero, so that an untrained
    compensator leaves the physics as it is.
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
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("scale", torch.ones(inputs))
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def standardise_on(self, inputs: Float[Tensor, "N I"], shares: slice) -> None:
        """Take mean and scale from training inputs; one that hardly varies keeps its unit.

        Args:
            shares: inputs from 0 to 1, which stay as they are: one that is rare in training may be common later.
        """
        mean, scale = inputs.mean(dim=0), inputs.std(dim=0)
        mean[shares], scale[shares] = 0.0, 1.0
        self.mean.copy_(mean)
        self.scale.copy_(torch.where(scale > 1e-3, scale, torch.ones_like(scale)))

    def start(self, inputs: Float[Tensor, "B H I"]) -> tuple[Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """Hidden and cell state from the inputs of the history."""
        _, (last, _) = self.init_cell((inputs - self.mean) / self.scale)
        hidden, cell = self.init_output(last[0]).chunk(2, dim=-1)
        return torch.tanh(hidden), cell

    def forward(
        self, inputs: Float[Tensor, "B I"], hidden: Float[Tensor, "B S"], cell: Float[Tensor, "B S"]
    ) -> tuple[Float[Tensor, "B O"], Float[Tensor, "B S"], Float[Tensor, "B S"]]:
        """One step: compensation, next hidden state, next cell state."""
        inputs = (inputs - self.mean) / self.scale
        hidden, cell = self.cell(inputs, (hidden, cell))
        return self.output(torch.cat((hidden, inputs), dim=-1)), hidden, cell
