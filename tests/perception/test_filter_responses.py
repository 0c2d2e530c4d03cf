"""Compiled loops of the filterbank against torch, which is their reference."""

import numpy as np
import pytest
import torch

from offpiste.perception.backbones import Backbone
from offpiste.perception.backbones.filterbank import Filterbank, derivatives, oriented_filters
from offpiste.perception.filter_responses import PRODUCTS, TAPS, patch_means

FILTERS = derivatives(1.0), [derivatives(1.0), derivatives(2.0)]


def reference(images: np.ndarray) -> torch.Tensor:
    return Backbone._features_of_pixels(Filterbank(), torch.from_numpy(images))


@pytest.mark.parametrize("shape", [(1, 28, 28), (2, 56, 70), (1, 42, 126), (1, 588, 952)])
def test_loops_give_the_features_of_torch(shape: tuple[int, int, int]):
    images = np.random.default_rng(len(shape)).integers(0, 256, (*shape, 3)).astype(np.uint8)
    images[:, : shape[1] // 3] //= 50  # dark, and nearly flat
    expected, features = reference(images), Filterbank()(images)
    assert features.dtype == torch.float32
    assert features.shape == expected.shape
    assert torch.allclose(features, expected, rtol=0, atol=5e-5)


@pytest.mark.parametrize("scale", [0.7, 1.0, 2.0, 3.1])
def test_products_of_lines_make_the_filters(scale: float):
    filters, expected = derivatives(scale), oriented_filters(scale)[:, 0].numpy()
    lines = filters.lines[:, : filters.size]
    assert not filters.lines[:, filters.size :].any()
    assert filters.lines.shape[1] % TAPS == 0
    products = np.stack([np.outer(lines[down], lines[across]) for across, down in PRODUCTS])
    np.testing.assert_allclose(np.einsum("kp,pij->kij", filters.weights, products), expected, atol=2e-7)


def test_a_flat_image_has_no_texture():
    for value in (0, 128, 255):
        means = patch_means(
            np.full((28, 42, 3), value, np.uint8), np.log(np.arange(256, dtype=np.float32) + 1), *FILTERS, 14
        )
        assert means.responses.shape == (24, 2, 3)
        assert means.responses.max() < 3e-6


def test_the_loops_are_used_for_bytes_alone(monkeypatch: pytest.MonkeyPatch):
    images = np.random.default_rng(1).integers(0, 256, (1, 28, 42, 3)).astype(np.uint8)
    floats = (torch.from_numpy(images).float() / 255).numpy()
    expected = Filterbank()(images)
    monkeypatch.setattr("offpiste.perception.backbones.filterbank.patch_means", None)
    assert torch.equal(Filterbank()(floats), reference(images))
    with pytest.raises(TypeError):
        Filterbank()(images)
    assert expected.shape == (1, 2, 3, Filterbank.channels)
