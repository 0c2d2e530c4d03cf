"""Backbones by name, which map RGB images to one feature vector per patch.

Modules of this package and extensions register a backbone in `BACKBONES`.
"""

import hashlib
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from offpiste.core.errors import PerceptionError
from offpiste.core.registry import Registry
from offpiste.native.threads import single_threaded_torch
from offpiste.perception.patch_grid import PatchGrid

DINOV2_SMALL: Final = "facebook/dinov2-small"  # DINOv2 ViT-S/14, the paper's backbone and the default


class Backbone(ABC):
    """Map from images to feature images."""

    name: str  # as given to `open_backbone`; stored with a PCA
    patch: int  # size of a patch [px]
    channels: int  # length of a feature vector

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Return all settings that determine the features, with a hash of weights; not the device."""

    @abstractmethod
    def _features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        """Compute features of images in [0, 1] on the backbone's device, with sides that are multiples of the patch."""

    def features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        """Compute features of cropped images in [0, 1] by torch operations alone, for tracing."""
        return self._features(images)

    def _features_of_pixels(self, pixels: Shaped[Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns C"]:
        """Compute features of cropped images as given to `__call__`; override for a faster path."""
        return self._features(_unit_range(pixels.to(self.device)))

    @property
    @abstractmethod
    def device(self) -> torch.device:
        """Device of the computation."""

    @property
    def fingerprint(self) -> str:
        """Hash of `settings`; backbones with equal fingerprints have equal features."""
        return hashlib.sha256(json.dumps(self.settings(), sort_keys=True).encode()).hexdigest()[:16]

    def grid(self, width: int, height: int) -> PatchGrid:
        """Return the patches of an image of this size [px]; refuse one smaller than a patch."""
        return PatchGrid(width, height, self.patch)

    def __call__(self, images: Shaped[np.ndarray | Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns C"]:
        """Compute float32 feature images on the backbone's device.

        Args:
            images: RGB, uint8 in [0, 255] or finite floats in [0, 1] (else `PerceptionError`); cropped to `grid`.
        """
        pixels = images if isinstance(images, Tensor) else torch.from_numpy(np.require(images, requirements=["C", "W"]))
        _, height, width, _ = pixels.shape
        rows, columns = self.grid(width, height).crop
        with torch.no_grad(), _in_full_precision():
            features = self._features_of_pixels(pixels[:, rows, columns])
            with single_threaded_torch():  # too few numbers for threads
                finite = bool(torch.isfinite(features.sum(dtype=torch.float64)))
        if not finite:
            how = "download its weights again: they may be damaged"
            raise PerceptionError("features are not finite", where=self.name, how=how)
        return features


@contextmanager
def _in_full_precision() -> Iterator[None]:
    """Disable TF32 convolutions on GPUs, so that features equal those of the CPU."""
    before = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = False
    try:
        yield
    finally:
        torch.backends.cudnn.allow_tf32 = before


def _unit_range(pixels: Shaped[Tensor, "B h w 3"]) -> Float[Tensor, "B 3 h w"]:
    """Return planes of float32 in [0, 1]."""
    planes = pixels.permute(0, 3, 1, 2)
    if pixels.dtype == torch.uint8:
        return planes.float() / 255
    if not pixels.is_floating_point():
        raise PerceptionError(f"images have type {pixels.dtype}", how="give uint8, or floats in [0, 1]")
    planes = planes.float()
    low, high = (float(limit) for limit in torch.aminmax(planes))
    if not (low >= 0.0 and high <= 1.0):
        what = f"pixels range from {low:g} to {high:g}, not within [0, 1]"
        raise PerceptionError(what, how="give uint8, or finite floats in [0, 1]")
    return planes


BACKBONES: Final[Registry[Callable[..., Backbone]]] = Registry("backbone", package=__name__, error=PerceptionError)
"""Backbones without files, such as a class whose `__init__` takes the `device`, by name."""


def open_backbone(name: str = DINOV2_SMALL, *, device: str = "cpu") -> Backbone:
    """Open a backbone by name; raise `PerceptionError` if it, its weights or the device is missing or unsuitable.

    Args:
        name: of `BACKBONES`, or a vision transformer: a folder with config.json and model.safetensors, or `owner/model`
            on the Hugging Face hub.
        device: "cpu", "cuda", "cuda:1" ...
    """
    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise PerceptionError(f"no device {device!r}: {reason}", how="give cpu, or install torch for it") from error
    place = torch.device(device)
    if name in BACKBONES:
        return BACKBONES[name](device=place)
    if "/" not in name and os.sep not in name and not Path(name).is_dir():
        known = ", ".join(sorted(BACKBONES))
        how = f"give {known}, or a vision transformer: its folder, or owner/model as in {DINOV2_SMALL}"
        raise PerceptionError(f"no backbone '{name}'", how=how)
    from offpiste.perception.backbones.vision_transformer import load_vision_transformer

    return load_vision_transformer(name, device=place)
