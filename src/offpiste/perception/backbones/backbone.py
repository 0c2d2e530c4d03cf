"""What every backbone is: RGB images in, one feature vector a patch out. `open_backbone` finds one by its name."""

import hashlib
import json
from abc import ABC, abstractmethod
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from offpiste.errors import PerceptionError
from offpiste.perception.patch_grid import PatchGrid

DINOV2_SMALL = "facebook/dinov2-small"
"""DINOv2 ViT-S/14, the paper's backbone and the default."""

FILTERBANK = "filterbank"
"""The stand-in without weights; used only where it is asked for by this name."""

Precision = Literal["fp32", "bf16"]


class Backbone(ABC):
    """Turns images into feature images.

    Attributes:
        name: what `open_backbone` found it by.
        patch: size of a patch [px].
        channels: C, length of a feature vector.
    """

    name: str
    patch: int
    channels: int

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """What its features depend on, weights included as a hash; precision and device are not part of it."""

    @abstractmethod
    def _features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        """Features of images in [0, 1] on the backbone's device, whose sides are multiples of the patch."""

    @property
    @abstractmethod
    def device(self) -> torch.device:
        """Where it computes."""

    @property
    def fingerprint(self) -> str:
        """Hash of `settings`: backbones of one fingerprint give the same features."""
        return hashlib.sha256(json.dumps(self.settings(), sort_keys=True).encode()).hexdigest()[:16]

    def grid(self, width: int, height: int) -> PatchGrid:
        """Where the patches of an image of this size [px] lie.

        Raises:
            PerceptionError: the image is smaller than one patch.
        """
        return PatchGrid(width, height, self.patch)

    def __call__(self, images: Shaped[np.ndarray | Tensor, "B h w 3"]) -> Float[Tensor, "B rows columns C"]:
        """Feature images, float32, on the backbone's device.

        Args:
            images: RGB, uint8 in [0, 255] or floats in [0, 1]; cropped as `grid` says.

        Raises:
            PerceptionError: images of another type, smaller than a patch, or not finite; features not finite.
        """
        pixels = images if isinstance(images, Tensor) else torch.from_numpy(np.require(images, requirements=["C", "W"]))
        _, height, width, _ = pixels.shape
        rows, columns = self.grid(width, height).crop
        with torch.no_grad():
            features = self._features(_unit_range(pixels[:, rows, columns].to(self.device)))
            finite = bool(torch.isfinite(features.sum(dtype=torch.float64)))
        if not finite:
            raise PerceptionError(
                "features are not finite", where=self.name, how="its weights may be broken: fetch them again"
            )
        return features


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


def open_backbone(name: str = DINOV2_SMALL, *, device: str = "cpu", precision: Precision = "fp32") -> Backbone:
    """A backbone by name.

    Args:
        name: `filterbank`, a folder with config.json and model.safetensors, or a model's name on the Hugging Face hub.
        device: "cpu", "cuda", "cuda:1" ...
        precision: of a transformer's matrix products; features are always given as float32.

    Raises:
        PerceptionError: weights that cannot be had, a model of another family, or a device that is not there.
    """
    place = _device(device)
    if name == FILTERBANK:
        from offpiste.perception.backbones.filterbank import Filterbank

        return Filterbank(device=place)
    from offpiste.perception.backbones.vision_transformer import load_vision_transformer

    return load_vision_transformer(name, device=place, precision=precision)


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise PerceptionError(f"no such device: {name!r}", how="give cpu or cuda") from error
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise PerceptionError(f"no device {name!r} here", how="give cpu")
    return device
