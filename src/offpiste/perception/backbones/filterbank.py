"""Filter bank without weights: colour and oriented texture of each patch at several scales.

Texture is the mean magnitude of derivatives of Gaussians, after Leung and Malik, "Representing and Recognizing the
Visual Appearance of Materials using Three-dimensional Textons", 2001. All features are computed on logarithms of the
colours, where exposure is a constant that differences and the image's median remove.
"""

import math
from typing import Any, Final, final

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor
from torch.nn import functional

from offpiste.native.threads import single_threaded_torch
from offpiste.perception.backbones import BACKBONES, Backbone
from offpiste.perception.filter_responses import PRODUCTS, Derivatives, patch_means

FILTERBANK: Final = "filterbank"

ORIENTATIONS = 4
SCALES = (1.0, 2.0, 4.0)  # standard deviations of the Gaussians [px]
CONTEXT = (3, 7)  # sides of the neighbourhoods for further averages of colour and texture [patches]
_DARKEST = 0.03  # added to colours before the logarithm to suppress noise in dark regions
_FAINTEST = 0.01  # added to mean responses before the logarithm, about the level of camera noise

_WEIGHTS = {"brightness": 0.45, "colour": 4.0, "spread": 0.7, "texture": 0.35}
"""Weights that equalise the variances of the groups for a PCA."""


@BACKBONES.register(FILTERBANK)
@final
class Filterbank(Backbone):
    """Filter bank with patches as large as DINOv2's."""

    name = FILTERBANK
    patch = 14
    channels = 3 * (1 + len(CONTEXT)) + 3 + 2 * len(SCALES) * (ORIENTATIONS + len(CONTEXT))

    def __init__(self, *, device: torch.device | None = None) -> None:
        self._device = device or torch.device("cpu")
        self._fine = oriented_filters(SCALES[0]).to(self._device)
        self._derivatives = [derivatives(scale) for scale in (SCALES[0], *(scale / 2 for scale in SCALES[1:]))]
        self._logarithms = torch.log(torch.arange(256) / 255 + _DARKEST).numpy()
        # The two coarser scales are computed at half resolution.
        self._coarse = [oriented_filters(scale / 2).to(self._device) for scale in SCALES[1:]]

    @property
    def device(self) -> torch.device:
        """Device of the computation."""
        return self._device

    def settings(self) -> dict[str, Any]:
        """Return the settings of the filters."""
        return {
            "kind": FILTERBANK,
            "version": 1,
            "patch": self.patch,
            "scales": list(SCALES),
            "orientations": ORIENTATIONS,
            "context": list(CONTEXT),
            "darkest": _DARKEST,
            "faintest": _FAINTEST,
            "weights": _WEIGHTS,
        }

    def _features_of_pixels(self, pixels: Shaped[Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns C"]:
        """Compute features of uint8 pixels on the CPU by compiled loops, in a sixth of the time."""
        if pixels.dtype != torch.uint8 or self._device.type != "cpu":
            return super()._features_of_pixels(pixels)
        fine, *coarse = self._derivatives
        means = [patch_means(image, self._logarithms, fine, coarse, self.patch) for image in pixels.numpy()]
        with single_threaded_torch():  # too few numbers for threads
            colours, squares, responses = (torch.from_numpy(np.stack(part)) for part in zip(*means, strict=True))
            return _features_of_means(colours, squares, responses)

    def _features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        planes = opponent_planes(images)
        colours, squares = (functional.avg_pool2d(part, self.patch) for part in (planes, planes.square()))
        return _features_of_means(colours, squares, self._responses(planes[:, :1]))

    def _responses(self, brightness: Float[Tensor, "B 1 h w"]) -> Float[Tensor, "B k rows columns"]:
        """Return the mean magnitude of each filter's response in each patch."""
        half = functional.avg_pool2d(brightness, 2)
        # At the finest scale, every second pixel suffices for a mean.
        means = [functional.avg_pool2d(respond(brightness, self._fine, stride=2).abs(), self.patch // 2)]
        means += [functional.avg_pool2d(respond(half, bank).abs(), self.patch // 2) for bank in self._coarse]
        return torch.cat(means, dim=1)


def _features_of_means(
    colour: Float[Tensor, "B 3 rows columns"],
    square: Float[Tensor, "B 3 rows columns"],
    responses: Float[Tensor, "B k rows columns"],
) -> Float[Tensor, "B rows columns C"]:
    """Compute features from patch means of opponent planes, their squares, and magnitudes of responses."""
    spread = (square - colour.square()).clamp_min(0.0).sqrt()
    texture = _WEIGHTS["texture"] * torch.log(responses + _FAINTEST)
    brightness = colour[:, 0].flatten(1).sort(dim=1).values  # ONNX has no median
    reference = brightness[:, (brightness.shape[1] - 1) // 2]
    relative = torch.cat((colour[:, :1] - reference[:, None, None, None], colour[:, 1:]), dim=1)
    relative = relative * relative.new_tensor([_WEIGHTS["brightness"], *2 * [_WEIGHTS["colour"]]]).view(1, 3, 1, 1)
    overall = texture.unflatten(1, (2 * len(SCALES), ORIENTATIONS)).mean(dim=2)
    near = [neighbourhood_mean(part, side) for side in CONTEXT for part in (relative, overall)]
    features = torch.cat((relative, _WEIGHTS["spread"] * torch.log(spread + _FAINTEST), texture, *near), dim=1)
    return features.permute(0, 2, 3, 1).contiguous()


def opponent_planes(images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B 3 h w"]:
    """Return log brightness and two log colour ratios.

    The ratios are red to green, and blue to the geometric mean of red and green. They do not depend on exposure.
    """
    red, green, blue = torch.log(images + _DARKEST).unbind(1)
    return torch.stack(((red + green + blue) / 3, red - green, blue - (red + green) / 2), dim=1)


def oriented_filters(scale: float) -> Float[Tensor, "k 1 size size"]:
    """Return first and second derivatives of a Gaussian [px] in `ORIENTATIONS` directions, of mean 0 and l1 norm 1."""
    reach = math.ceil(3 * scale)
    across = torch.arange(-reach, reach + 1, dtype=torch.float64) / scale
    y, x = torch.meshgrid(across, across, indexing="ij")
    gaussian = torch.exp(-(x.square() + y.square()) / 2)
    angles = [math.pi * number / ORIENTATIONS for number in range(ORIENTATIONS)]
    along = [x * math.cos(angle) + y * math.sin(angle) for angle in angles]
    filters = torch.stack([-u * gaussian for u in along] + [(u.square() - 1) * gaussian for u in along])
    filters = filters - filters.mean(dim=(1, 2), keepdim=True)
    return (filters / filters.abs().sum(dim=(1, 2), keepdim=True)).float().unsqueeze(1)


def derivatives(scale: float) -> Derivatives:
    """Return the filters of `oriented_filters` as sums of separable filters."""
    reach = math.ceil(3 * scale)
    x = np.arange(-reach, reach + 1) / scale
    g = np.exp(-x * x / 2)
    lines = np.stack((g, x * g, x * x * g, np.ones_like(x)))
    across, down = np.array(PRODUCTS).T
    products = lines[down, :, None] * lines[across, None, :]
    angles = math.pi * np.arange(ORIENTATIONS) / ORIENTATIONS
    cos, sin, none = np.cos(angles), np.sin(angles), np.zeros(ORIENTATIONS)
    first = np.stack((-cos, -sin, none, none, none, none, none), axis=1)
    second = np.stack((none, none, cos * cos, 2 * cos * sin, sin * sin, none - 1, none), axis=1)
    weights = np.concatenate((first, second))
    weights[:, 6] = -(weights @ products.mean(axis=(1, 2)))
    weights /= np.abs(np.einsum("kp,pij->kij", weights, products)).sum(axis=(1, 2))[:, None]
    return Derivatives(lines.astype(np.float32), weights.astype(np.float32))


def respond(plane: Float[Tensor, "B 1 h w"], filters: Float[Tensor, "k 1 s s"], *, stride: int = 1) -> Tensor:
    """Return the responses to filters, with the image mirrored at its edges."""
    reach = filters.shape[-1] // 2
    return functional.conv2d(functional.pad(plane, (reach,) * 4, mode="reflect"), filters, stride=stride)


def neighbourhood_mean(features: Float[Tensor, "B k rows columns"], side: int) -> Float[Tensor, "B k rows columns"]:
    """Return the mean over side x side patches around each, cut off at the image's edges."""
    return functional.avg_pool2d(features, side, stride=1, padding=side // 2, count_include_pad=False)
