"""The compensating network: neutral before training, its state set by the history."""

import torch

from factories import gradients_agree, unsettled
from offpiste.dynamics.lstm import Compensator


def test_untrained_it_compensates_nothing():
    network = Compensator(5, 3)
    out, hidden, _ = network(torch.randn(7, 5), *network.start(torch.randn(7, 10, 5)))
    assert (out == 0).all()
    assert (hidden != 0).any()


def test_it_has_the_papers_sizes():
    network = Compensator(5, 3)
    assert network.cell.hidden_size == 4
    assert network.init_cell.hidden_size == 20
    assert network.output[0].out_features == 20


def test_its_step_is_an_lstm_cell_on_standardised_inputs():
    network = unsettled(Compensator(2, 1).double())
    network.standardise_on(torch.tensor([[0.0, 10.0], [2.0, 10.0]]).double(), slice(0))
    x, h, c = torch.tensor([[3.0, 11.0]]).double(), torch.rand(1, 4).double(), torch.rand(1, 4).double()
    # Column 0: mean 1, deviation sqrt(2); column 1 does not vary and keeps its unit.
    seen = torch.tensor([[2 / 2**0.5, 1.0]]).double()
    cell = network.cell
    gates = seen @ cell.weight_ih.T + cell.bias_ih + h @ cell.weight_hh.T + cell.bias_hh
    i, f, g, o = gates.chunk(4, dim=-1)
    next_c = f.sigmoid() * c + i.sigmoid() * g.tanh()
    next_h = o.sigmoid() * next_c.tanh()
    out, hidden, memory = network(x, h, c)
    torch.testing.assert_close(hidden, next_h)
    torch.testing.assert_close(memory, next_c)
    torch.testing.assert_close(out, network.output(torch.cat((next_h, seen), -1)))


def test_it_fades_where_inputs_leave_their_range_and_sees_the_end_of_the_range():
    network = unsettled(Compensator(3, 2).double())
    rows = torch.linspace(-1, 1, 2001, dtype=torch.float64)[:, None] * torch.tensor([1.0, 10.0, 0.0]).double() + 5
    # The second input is a share, the third does not vary: its range is a point.
    network.standardise_on(rows, slice(1, 2), ranged=3)
    at_end, state = torch.tensor([[5.99, 3.0, 5.0]], dtype=torch.float64), torch.rand(2, 1, 4).double()
    reference, *memory = network(at_end, *state)
    torch.testing.assert_close(network.high[0] * network.scale[0] + network.mean[0], at_end[0, 0])
    sigma = network.scale[0].item()
    for beyond, factor in (0.0, 1.0), (0.5, 1 / 3.5), (1.0, 1 / 11), (100.0, 1 / 100_001):
        out, *same = network(at_end + torch.tensor([beyond * sigma, 0.0, 0.0]).double(), *state)
        torch.testing.assert_close(out, factor * reference)
        torch.testing.assert_close(same, memory)
    both = network(at_end + torch.tensor([sigma, 0.0, -2.0]).double(), *state)[0]
    torch.testing.assert_close(both, reference / 51)
    assert not torch.allclose(network(at_end + torch.tensor([0.0, 9.0, 0.0]), *state)[0], reference)
    history = at_end.expand(1, 10, 3)
    beyond = history + torch.tensor([7.0, 0.0, 0.0])
    torch.testing.assert_close(network.start(beyond), network.start(history))


def test_every_row_of_the_history_counts():
    network = unsettled(Compensator(3, 1).double())
    history = torch.randn(1, 10, 3).double()
    reference = network.start(history)
    for row in range(10):
        changed = history.clone()
        changed[0, row] += 1
        assert not torch.allclose(network.start(changed)[1], reference[1], rtol=0, atol=1e-9)


def test_gradients_equal_finite_differences():
    network = unsettled(Compensator(3, 2).double())
    history, now = torch.randn(2, 10, 3).double(), torch.randn(2, 3).double()

    def run(network: Compensator) -> torch.Tensor:
        out, *memory = network(now, *network.start(history))
        return out + network(now + 1, *memory)[0]

    assert gradients_agree(network, run)
