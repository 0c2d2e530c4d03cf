"""The hybrid model with a GRU in place of its LSTM.

    export PYTHONPATH=examples/extending OFFPISTE_EXTENSIONS=gated
    offpiste train dataset.zarr --out run --model b-gru

The generated kernels cover LSTMs only, so that offpiste warns once and steps this model eagerly.
"""

from torch import Tensor, nn

from offpiste.dynamics import Hybrid, Vehicle, register_model


class GatedCell(nn.Module):
    """A GRU cell with the interface of `nn.LSTMCell`; the cell state passes through unread."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.gru = nn.GRUCell(inputs, hidden)

    def forward(self, inputs: Tensor, state: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """Return the next hidden state [B, S] and the cell state as it was [B, S]."""
        hidden, cell = state
        return self.gru(inputs, hidden), cell


@register_model("b-gru", colour="#4d4d4d", what="b with a GRU")
def gated(vehicle: Vehicle) -> Hybrid:
    """Return the hybrid model without terrain features, with a GRU."""
    model = Hybrid(vehicle)
    network = model.compensator
    network.cell = GatedCell(network.cell.input_size, network.hidden)  # type: ignore[assignment]
    return model
