"""Compiled loops of the filterbank against torch, which is their reference: the same bits."""

import platform

import numpy as np
import pytest
import torch

from offpiste.perception.backbones import Backbone
from offpiste.perception.backbones.filterbank import Filterbank

X86 = platform.machine() in ("x86_64", "AMD64")


def reference(images: np.ndarray) -> torch.Tensor:
    return Backbone._features_of_pixels(Filterbank(), torch.from_numpy(images))


@pytest.mark.parametrize("shape", [(1, 28, 28), (2, 56, 70), (1, 42, 126), (1, 588, 952)])
def test_loops_give_the_features_of_torch(shape: tuple[int, int, int]):
    images = np.random.default_rng(len(shape)).integers(0, 256, (*shape, 3)).astype(np.uint8)
    images[:, : shape[1] // 3] //= 50  # dark, and nearly flat
    expected, features = reference(images), Filterbank()(images)
    assert features.dtype == torch.float32
    assert features.shape == expected.shape
    if X86:
        assert torch.equal(features, expected)
    else:  # whose convolution may add the taps in another order
        assert torch.allclose(features, expected, atol=1e-5)


def test_the_loops_are_used_for_bytes_alone(monkeypatch: pytest.MonkeyPatch):
    images = np.random.default_rng(1).integers(0, 256, (1, 28, 42, 3)).astype(np.uint8)
    floats = (torch.from_numpy(images).float() / 255).numpy()
    expected = Filterbank()(images)
    monkeypatch.setattr("offpiste.perception.backbones.filterbank.patch_means", None)
    assert torch.equal(Filterbank()(floats), reference(images))
    with pytest.raises(TypeError):
        Filterbank()(images)
    assert expected.shape == (1, 2, 3, Filterbank.channels)
