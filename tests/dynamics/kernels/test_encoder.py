"""The encoder's kernels against the eager layers in float64: codes, and the gradients of all weights."""

import copy

import pytest
import torch
from torch import Tensor

from dynamics.kernels.test_rollout import Result, assert_agree, assert_same_for_threads, gradients
from offpiste.dynamics.feature_encoder import Compressor, Identity
from offpiste.dynamics.kernels.encoder import CELLS, encode_cells, supports_encoder


def example(features: int = 8, size: int = 4) -> Compressor:
    """Random weights, means and scales, in float64."""
    torch.manual_seed(0)
    encoder = Compressor(features, size=size)
    for parameter in encoder.parameters():
        parameter.data += 0.3 * torch.randn_like(parameter)
    encoder.mean += torch.randn_like(encoder.mean)
    encoder.scale *= 0.5 + torch.rand_like(encoder.scale)
    return encoder.double()


def cells(count: int, features: int) -> tuple[Tensor, Tensor]:
    """Random cells, some without features (NaN), a few far outside of what the scale says."""
    draw = torch.Generator().manual_seed(count)
    values, valid = torch.randn(count, features, generator=draw), torch.rand(count, generator=draw) < 0.7
    values[::11] *= 30
    values[~valid] = torch.nan
    return values, valid


def run(encoder: Compressor, values: Tensor, valid: Tensor, *, eager: bool) -> Result:
    """Codes and their gradients."""
    values = values.to(encoder.mean.dtype)
    assert supports_encoder(encoder, values) is not eager
    codes = encoder(values, valid) if eager else encode_cells(encoder, values, valid)
    return (codes,), gradients(encoder, {}, codes)


@pytest.mark.parametrize(
    ("count", "features", "size"),
    [(1, 8, 4), (CELLS, 40, 4), (CELLS + 1, 5, 1), (300, 2, 3), (2 * CELLS + 70, 40, 16)],
)
def test_kernels_agree_with_the_eager_layers(count: int, features: int, size: int) -> None:
    encoder, (values, valid) = example(features, size), cells(count, features)
    found = run(copy.deepcopy(encoder).float(), values, valid, eager=False)
    assert_agree(found, run(encoder, values, valid, eager=True))


def test_missing_features_and_those_beyond_the_first_are_not_read() -> None:
    encoder, (values, valid) = example(5).float(), cells(100, 9)
    assert torch.equal(encode_cells(encoder, values, valid), encode_cells(encoder, values[:, :5], valid))
    codes = encode_cells(encoder, values, torch.zeros_like(valid))
    torch.testing.assert_close(codes, encoder.missing().expand_as(codes), atol=1e-5, rtol=1e-5)


def test_numbers_do_not_depend_on_gradients_and_threads() -> None:
    encoder, (values, valid) = example().float(), cells(5 * CELLS, 8)
    assert_same_for_threads(lambda: run(encoder, values, valid, eager=False))


def test_unsupported_input_is_left_to_torch() -> None:
    values, _ = cells(3, 8)
    assert supports_encoder(example().float(), values)
    assert not supports_encoder(example(), values)
    assert not supports_encoder(Identity(8), values)
    assert not supports_encoder(example().float(), values.nan_to_num().requires_grad_())
