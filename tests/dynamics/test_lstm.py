"""The correcting network: neutral before training, fading beyond its range, its state set by the history."""

import torch

from factories import drawn, gradients_agree, unsettled
from offpiste.dynamics.lstm import Compensator


def test_it_has_the_papers_sizes_and_corrects_nothing_before_training():
    network = Compensator(5, 3)
    assert (network.cell.hidden_size, network.init_cell.hidden_size, network.output[0].out_features) == (4, 20, 20)
    out, state = network(drawn(7, 5).float(), network.start(drawn(7, 10, 5).float()))
    assert (out == 0).all()
    assert (state != 0).any()


def test_its_step_is_an_lstm_cell_on_standardised_inputs():
    network = unsettled(Compensator(2, 1).double())
    network.standardise_on(torch.tensor([[0.0, 10.0], [2.0, 10.0]]).double(), slice(0))
    x, h, c = torch.tensor([[3.0, 11.0]]).double(), drawn(1, 4), drawn(1, 4, seed=1)
    # Column 0: mean 1, deviation sqrt(2); column 1 does not vary and keeps its unit.
    seen = torch.tensor([[2 / 2**0.5, 1.0]]).double()
    cell = network.cell
    gates = seen @ cell.weight_ih.T + cell.bias_ih + h @ cell.weight_hh.T + cell.bias_hh
    i, f, g, o = gates.chunk(4, dim=-1)
    next_c = f.sigmoid() * c + i.sigmoid() * g.tanh()
    next_h = o.sigmoid() * next_c.tanh()
    out, state = network(x, torch.cat((h, c), -1))
    torch.testing.assert_close(state, torch.cat((next_h, next_c), -1))
    torch.testing.assert_close(out, network.output(torch.cat((next_h, seen), -1)))


def test_beyond_their_range_inputs_are_clamped_and_the_output_fades():
    network = unsettled(Compensator(3, 2).double())
    rows = torch.linspace(-1, 1, 2001, dtype=torch.float64)[:, None] * torch.tensor([1.0, 10.0, 0.0]).double() + 5
    # The second input is a share, the third does not vary: its range is a point.
    network.standardise_on(rows, slice(1, 2), ranged=3)
    at_end, state = torch.tensor([[5.99, 3.0, 5.0]], dtype=torch.float64), drawn(1, 8)
    reference, after = network(at_end, state)
    torch.testing.assert_close(network.high[0] * network.scale[0] + network.mean[0], at_end[0, 0])
    sigma = network.scale[0].item()
    for beyond, factor in (0.0, 1.0), (0.5, 1 / 3.5), (100.0, 1 / 100_001):
        out, same = network(at_end + torch.tensor([beyond * sigma, 0.0, 0.0]).double(), state)
        torch.testing.assert_close(out, factor * reference)
        torch.testing.assert_close(same, after)
    both = network(at_end + torch.tensor([sigma, 0.0, -2.0]).double(), state)[0]
    torch.testing.assert_close(both, reference / 51)
    assert not torch.allclose(network(at_end + torch.tensor([0.0, 9.0, 0.0]), state)[0], reference)
    history = at_end.expand(1, 10, 3)
    torch.testing.assert_close(network.start(history + torch.tensor([7.0, 0.0, 0.0])), network.start(history))


def test_every_row_of_the_history_counts():
    network = unsettled(Compensator(3, 1).double())
    history = drawn(1, 10, 3)
    changed = history.repeat(10, 1, 1) + torch.eye(10)[..., None]
    apart = (network.start(changed) - network.start(history)).abs().amax(dim=1)
    assert (apart > 1e-9).all()


def test_gradients_equal_finite_differences():
    network = unsettled(Compensator(3, 2).double())
    history, now = drawn(2, 10, 3), drawn(2, 3)

    def run(network: Compensator) -> torch.Tensor:
        out, state = network(now, network.start(history))
        return out + network(now + 1, state)[0]

    assert gradients_agree(network, run)
