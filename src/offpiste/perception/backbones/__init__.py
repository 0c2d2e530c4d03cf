"""Backbones by name: RGB images in, one feature vector a patch out.

A backbone is one module here, or one of an extension, that registers itself in `BACKBONES`.
"""

import hashlib
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal, Protocol

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from offpiste.core.errors import PerceptionError
from offpiste.core.registry import Registry
from offpiste.native.compilation import single_threaded_torch
from offpiste.perception.patch_grid import PatchGrid

DINOV2_SMALL: Final = "facebook/dinov2-small"
"""DINOv2 ViT-S/14, the paper's backbone and the default."""

Precision = Literal["fp32", "bf16"]


class Backbone(ABC):
    """Turns images into feature images.

    Attributes:
        name: the name that `open_backbone` was given; a PCA keeps it.
        patch: size of a patch [px].
        channels: C, length of a feature vector.
    """

    name: str
    patch: int
    channels: int

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Everything its features depend on, weights as a hash; not precision and device."""

    @abstractmethod
    def _features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        """Features of images in [0, 1] on the backbone's device, whose sides are multiples of the patch."""

    def features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        """Features by torch's operations alone, as graphs are traced from, of images in [0, 1] cropped to `grid`."""
        return self._features(images)

    def _features_of_pixels(self, pixels: Shaped[Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns C"]:
        """Features of images as `__call__` is given them, cropped; a backbone may have a way that is faster."""
        return self._features(_unit_range(pixels.to(self.device)))

    @property
    @abstractmethod
    def device(self) -> torch.device:
        """Device it computes on."""

    @property
    def fingerprint(self) -> str:
        """Hash of `settings`: backbones of one fingerprint give the same features."""
        return hashlib.sha256(json.dumps(self.settings(), sort_keys=True).encode()).hexdigest()[:16]

    def grid(self, width: int, height: int) -> PatchGrid:
        """Patches of an image of this size [px].

        Raises:
            PerceptionError: the image is smaller than one patch.
        """
        return PatchGrid(width, height, self.patch)

    def __call__(self, images: Shaped[np.ndarray | Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns C"]:
        """Feature images, float32, on the backbone's device.

        Args:
            images: RGB, uint8 in [0, 255] or floats in [0, 1]; cropped to `grid`.

        Raises:
            PerceptionError: images of another type, smaller than a patch, or not finite; features not finite.
        """
        pixels = images if isinstance(images, Tensor) else torch.from_numpy(np.require(images, requirements=["C", "W"]))
        _, height, width, _ = pixels.shape
        rows, columns = self.grid(width, height).crop
        with torch.no_grad(), _in_full_precision():
            features = self._features_of_pixels(pixels[:, rows, columns])
            with single_threaded_torch():  # threads that are woken for this spin for longer than it takes
                finite = bool(torch.isfinite(features.sum(dtype=torch.float64)))
        if not finite:
            raise PerceptionError(
                "features are not finite", where=self.name, how="its weights may be broken: fetch them again"
            )
        return features


@contextmanager
def _in_full_precision() -> Iterator[None]:
    """On GPUs, convolutions of float32 that do not round to 10 bits (TF32): features are those of the CPU."""
    before = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = False
    try:
        yield
    finally:
        torch.backends.cudnn.allow_tf32 = before


def _unit_range(pixels: Shaped[Tensor, "B h w 3"]) -> Float[Tensor, "B 3 h w"]:
    """Planes of float32 in [0, 1]."""
    planes = pixels.permute(0, 3, 1, 2)
    if pixels.dtype == torch.uint8:
        return planes.float() / 255
    if not pixels.is_floating_point():
        raise PerceptionError(f"images of type {pixels.dtype}", how="give uint8, or floats in [0, 1]")
    planes = planes.float()
    low, high = (float(limit) for limit in torch.aminmax(planes))
    if not (low >= 0.0 and high <= 1.0):
        raise PerceptionError(
            f"pixels from {low:g} to {high:g}, not in [0, 1]", how="give uint8, or finite floats in [0, 1]"
        )
    return planes


class MakeBackbone(Protocol):
    """Makes a backbone that needs no files; a class whose `__init__` takes the device does."""

    def __call__(self, *, device: torch.device) -> Backbone:
        """The backbone, ready to use."""


BACKBONES: Final[Registry[MakeBackbone]] = Registry("backbone", package=__name__, error=PerceptionError)
"""Backbones that have a name of their own; vision transformers go by that of their weights."""


def open_backbone(name: str = DINOV2_SMALL, *, device: str = "cpu", precision: Precision = "fp32") -> Backbone:
    """A backbone by name.

    Args:
        name: of `BACKBONES`; or a vision transformer: a folder with config.json and model.safetensors, or `owner/model`
            on the Hugging Face hub.
        device: "cpu", "cuda", "cuda:1" ...
        precision: of a transformer's matrix products; features are always given as float32.

    Raises:
        PerceptionError: no such backbone, weights that cannot be had, a model of another family, or a device that is
            not there.
    """
    place = _device(device)
    if name in BACKBONES:
        return BACKBONES[name](device=place)
    if "/" not in name and os.sep not in name and not Path(name).is_dir():
        known = ", ".join(sorted(BACKBONES))
        how = f"give {known}, or a vision transformer: its folder, or owner/model as in {DINOV2_SMALL}"
        raise PerceptionError(f"no backbone '{name}'", how=how)
    from offpiste.perception.backbones.vision_transformer import load_vision_transformer

    return load_vision_transformer(name, device=place, precision=precision)


def _device(name: str) -> torch.device:
    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise PerceptionError(f"no device {name!r}: {reason}", how="give cpu, or install torch for it") from error
    return torch.device(name)
