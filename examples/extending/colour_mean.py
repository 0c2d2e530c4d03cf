"""A visual backbone from outside: the mean colour of each patch, the plainest one there is.

    OFFPISTE_EXTENSIONS=colour_mean PYTHONPATH=examples/extending offpiste fit-pca drive.mcap --backbone colour-mean ...

A file like this one in `src/offpiste/perception/backbones/` is found by itself.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from offpiste.perception.backbones import BACKBONES, Backbone


@BACKBONES.register("colour-mean")
class ColourMean(Backbone):
    """Mean red, green and blue of each patch of 14 x 14 pixels."""

    name = "colour-mean"
    patch = 14
    channels = 3

    def __init__(self, *, device: torch.device) -> None:
        self._device = device

    @property
    def device(self) -> torch.device:
        """Device it computes on."""
        return self._device

    def settings(self) -> dict[str, Any]:
        """Everything the features depend on: datasets of other settings do not mix with these."""
        return {"kind": self.name, "version": 1, "patch": self.patch}

    def _features(self, images: Float[Tensor, "B 3 h w"]) -> Float[Tensor, "B rows columns C"]:
        return functional.avg_pool2d(images, self.patch).permute(0, 2, 3, 1).contiguous()
