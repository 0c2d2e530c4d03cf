"""Codes of ground cells: missing features are filled and flagged, and never read."""

import math
from dataclasses import replace

import pytest
import torch

from factories import VEHICLE
from offpiste.core.errors import RunError
from offpiste.dynamics import MODELS
from offpiste.dynamics.feature_encoder import Compressor, Identity
from offpiste.training.run import build


def test_the_identity_returns_features_and_a_flag_and_ignores_missing_ones():
    encoder = Identity(2)
    encoder.fill_with(torch.tensor([[1.0, 2.0], [3.0, 6.0], [math.nan, math.nan]]), torch.tensor([True, True, False]))
    codes = encoder(torch.tensor([[5.0, 7.0], [math.nan, 1e30]]), torch.tensor([True, False]))
    assert codes.tolist() == [[5.0, 7.0, -1.0], [2.0, 4.0, 1.0]]
    assert encoder.missing().tolist() == [2.0, 4.0, 1.0]
    encoder.fill_with(torch.full((3, 2), math.nan), torch.zeros(3, dtype=torch.bool))
    assert encoder.missing().tolist() == [2.0, 4.0, 1.0]
    features = torch.tensor([[math.nan, math.nan], [1.0, 2.0]], requires_grad=True)
    Identity(2)(features, torch.tensor([False, True])).sum().backward()
    assert features.grad.tolist() == [[0.0, 0.0], [1.0, 1.0]]


def test_compression_depends_neither_on_units_nor_on_missing_features():
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
    constant = Compressor(1)
    constant.fill_with(torch.full((4, 1), 3.0), torch.ones(4, dtype=torch.bool))
    assert constant(torch.tensor([[3.0]]), torch.tensor([True])).isfinite().all()


@pytest.mark.parametrize("kind", [Identity, Compressor])
def test_an_encoder_reads_the_first_features_of_cells_that_have_more(kind):
    torch.manual_seed(0)
    features, valid = torch.randn(30, 5), torch.arange(30) % 4 > 0
    cut, whole = kind(2), kind(2)
    whole.load_state_dict(cut.state_dict())
    cut.fill_with(features[:, :2], valid)
    whole.fill_with(features, valid)
    assert torch.equal(cut(features[:, :2], valid), whole(features, valid))


def test_settings_determine_the_features_read_and_the_length_of_the_code():
    vehicle = replace(VEHICLE, features=7, pca=5, codes=2)
    assert [MODELS[name](vehicle, seed=0).codes for name in ("cf", "df", "b")] == [2, 6, 0]
    assert MODELS["dc"](vehicle, seed=0).encoder.layers[0].in_features == 6
    assert MODELS["df"](replace(vehicle, pca=0), seed=0).codes == 8
    with pytest.raises(RunError):
        build("cf", replace(vehicle, pca=8), seed=0)
