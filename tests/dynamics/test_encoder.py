"""Codes of ground cells: what is missing is filled and flagged, and its numbers are never read."""

import math

import torch

from offpiste.dynamics.encoder import Compressor, Identity


def test_the_identity_gives_features_and_a_flag():
    encoder = Identity(2)
    encoder.fill_with(torch.tensor([[1.0, 2.0], [3.0, 6.0], [math.nan, math.nan]]), torch.tensor([True, True, False]))
    codes = encoder(torch.tensor([[5.0, 7.0], [math.nan, 1e30]]), torch.tensor([True, False]))
    assert codes.tolist() == [[5.0, 7.0, -1.0], [2.0, 4.0, 1.0]]
    assert encoder.missing().tolist() == [2.0, 4.0, 1.0]


def test_gradients_stay_finite_where_features_are_missing():
    features = torch.tensor([[math.nan, math.nan], [1.0, 2.0]], requires_grad=True)
    Identity(2)(features, torch.tensor([False, True])).sum().backward()
    assert features.grad.tolist() == [[0.0, 0.0], [1.0, 1.0]]


def test_nothing_valid_leaves_the_mean_alone():
    encoder = Identity(1)
    encoder.fill_with(torch.full((3, 1), math.nan), torch.zeros(3, dtype=torch.bool))
    assert encoder.missing().tolist() == [0.0, 1.0]


def test_compression_reads_neither_units_nor_what_is_missing():
    torch.manual_seed(0)
    features, valid = torch.randn(50, 3), torch.arange(50) % 5 > 0
    encoder, other = Compressor(3), Compressor(3)
    other.load_state_dict(encoder.state_dict())
    encoder.fill_with(features, valid)
    stretched = features * torch.tensor([1e3, 1e-3, 5.0]) + 7
    other.fill_with(stretched, valid)
    codes = encoder(features, valid)
    torch.testing.assert_close(other(stretched, valid), codes, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(codes[~valid], encoder.missing().expand(10, 4))
    assert not torch.allclose(codes[valid][0], codes[valid][1])


def test_a_constant_feature_does_not_blow_up():
    encoder = Compressor(1)
    encoder.fill_with(torch.full((4, 1), 3.0), torch.ones(4, dtype=torch.bool))
    assert encoder(torch.tensor([[3.0]]), torch.tensor([True])).isfinite().all()
