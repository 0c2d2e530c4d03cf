"""Codes of ground cells: what is missing is filled and flagged, and its numbers are never read."""

import math

import torch

from offpiste.dynamics.encoder import Identity


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
