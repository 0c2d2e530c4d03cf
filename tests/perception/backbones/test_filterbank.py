"""Responses of the filterbank to colour, direction, scale and real ground, and its features against torch's."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from offpiste.perception import filter_responses
from offpiste.perception.backbones.filterbank import (
    ORIENTATIONS,
    SCALES,
    Filterbank,
    derivatives,
)

TEXTURE = slice(6, 6 + 2 * ORIENTATIONS * len(SCALES))
"""After 3 of colour and 3 of its spread."""


def test_stripes_answer_most_in_their_direction_and_at_their_width():
    x = np.arange(98)
    for number, wavelength in enumerate(2 * np.pi * scale for scale in SCALES):
        stripes = 0.5 + 0.2 * np.sin(2 * np.pi * x / wavelength)
        upright = np.broadcast_to(stripes[None, :, None], (98, 98, 3)).astype(np.float32)
        texture = Filterbank()(upright[None].copy())[0, 3, 3, TEXTURE].reshape(len(SCALES), 2, ORIENTATIONS)
        assert (texture.argmax(dim=2) == 0).all()  # derivatives along x
        lying = Filterbank()(upright.transpose(1, 0, 2)[None].copy())[0, 3, 3, TEXTURE]
        assert (lying.reshape(len(SCALES), 2, ORIENTATIONS).argmax(dim=2) == 2).all()
        assert int(texture[:, 1, 0].argmax()) == number


def test_exposure_changes_little():
    generator = np.random.default_rng(0)
    scene = cv2.GaussianBlur(generator.uniform(0.1, 0.5, size=(112, 140, 3)), (0, 0), 3)
    scene = np.clip((scene - 0.3) * 4 + 0.35, 0.1, 0.6).astype(np.float32)
    scene[:56] *= np.array([0.9, 1.0, 0.5], dtype=np.float32)  # another ground kind
    bank = Filterbank()
    plain, brighter = bank(scene[None]), bank(1.5 * scene[None])
    between_kinds = (plain[:, :4].mean(dim=(0, 1, 2)) - plain[:, 4:].mean(dim=(0, 1, 2))).norm()
    moved = (brighter - plain).mean(dim=(0, 1, 2)).norm()
    assert moved < 0.15 * between_kinds


def test_trail_and_vegetation_differ_in_a_photograph(data_folder: Path):
    """Gravel in the middle of `run4`, bushes left and right of it: looked at, and marked by hand."""
    path = data_folder / "tartandrive2" / "images" / "run4.png"
    image = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    features = Filterbank()(image[None])[0]
    assert features.shape == (38, 73, 48)
    trail = features[24:33, 25:48].flatten(0, 1)
    bushes = torch.cat((features[14:20, 3:16].flatten(0, 1), features[12:18, 58:70].flatten(0, 1)))
    apart = trail.mean(dim=0) - bushes.mean(dim=0)
    direction = apart / (trail.var(dim=0) + bushes.var(dim=0))
    scores = [(part @ direction) for part in (trail, bushes)]
    middle = (scores[0].mean() + scores[1].mean()) / 2
    right = torch.cat((scores[0] > middle, scores[1] < middle)).float().mean()
    assert right > 0.97


def reference(images: np.ndarray) -> torch.Tensor:
    """Return the features that torch computes with double precision."""
    bank = Filterbank()
    bank._fine, bank._coarse = bank._fine.double(), [filters.double() for filters in bank._coarse]
    return bank._features(torch.from_numpy(images).permute(0, 3, 1, 2) / torch.tensor(255.0, dtype=torch.float64))


@pytest.mark.parametrize("shape", [(1, 28, 28), (2, 56, 70), (1, 42, 126)])
def test_features_are_those_of_torch(shape: tuple[int, int, int]):
    images = np.random.default_rng(len(shape)).integers(0, 256, (*shape, 3)).astype(np.uint8)
    images[:, : shape[1] // 3] //= 50  # dark, and nearly flat
    expected, features = reference(images), Filterbank()(images)
    assert features.dtype == torch.float32
    assert features.shape == expected.shape
    difference = (features - expected).abs().amax(dim=(0, 1, 2))
    assert difference[3:6].max() < 5e-4  # the spread of a flat patch is a small difference of large means
    assert torch.cat((difference[:3], difference[6:])).max() < 1e-5


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0, 5.0])
def test_compiled_responses_are_the_plain_ones(step: int, scale: float, monkeypatch: pytest.MonkeyPatch):
    image = np.random.default_rng(0).normal(size=(57, 127)).astype(np.float32)
    found = filter_responses.mean_magnitudes(image, derivatives(scale), 7, step)
    assert found.shape == (2 * ORIENTATIONS, 57 // (7 * step), 127 // (7 * step))
    monkeypatch.setattr(filter_responses, "put_responses", filter_responses.put_responses.plain)
    expected = filter_responses.mean_magnitudes(image, derivatives(scale), 7, step)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_filters_that_the_library_does_not_cover_are_refused():
    fine = derivatives(1.0)
    wrong = [(derivatives(6.0), 1), (fine, 3), (fine._replace(weights=fine.weights[:, :6]), 1)]
    for filters, step in [*wrong, (fine._replace(lines=fine.lines[:, :6]), 1)]:
        with pytest.raises(ValueError, match="lines"):
            filter_responses.mean_magnitudes(np.zeros((28, 28), np.float32), filters, 7, step)
