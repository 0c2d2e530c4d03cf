"""Encoders of the terrain features under a wheel."""

from abc import ABC, abstractmethod

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn


class FeatureEncoder(nn.Module, ABC):
    """Encoder of single cells with the same weights for all four wheels. Subclasses are final.

    If cells have more features than the encoder reads, it reads the first ones (principal components in order).

    Attributes:
        size: E, length of a code.
        mean: mean features of training cells, which replace missing ones.
    """

    size: int
    mean: Tensor

    @abstractmethod
    def forward(self, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]) -> Float[Tensor, "M E"]:
        """Return the codes of cells; invalid features are ignored."""

    def missing(self) -> Float[Tensor, " E"]:
        """Return the code of a cell without features."""
        nothing = self.mean[None]
        return self(nothing, torch.zeros(1, dtype=torch.bool, device=nothing.device))[0]

    def fill_with(self, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]) -> None:
        """Set the mean from training cells."""
        if valid.any():
            self.mean.copy_(features[valid, : len(self.mean)].double().mean(dim=0))


class Identity(FeatureEncoder):
    """Unencoded features (`df`), missing ones filled, and a flag: +1 missing, -1 present."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.size = features + 1
        self.register_buffer("mean", torch.zeros(features))

    def forward(self, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]) -> Float[Tensor, "M E"]:
        """Return features and flag."""
        return with_flag(features[:, : len(self.mean)], valid, self.mean)


class Compressor(FeatureEncoder):
    """Network with two hidden layers (64, 32; tanh) from features and flag to a code (`cf`, `dc`; paper, section V)."""

    scale: Tensor

    def __init__(self, features: int, *, size: int = 4) -> None:
        super().__init__()
        self.size = size
        self.layers = nn.Sequential(
            nn.Linear(features + 1, 64), nn.Tanh(), nn.Linear(64, 32), nn.Tanh(), nn.Linear(32, size)
        )
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("scale", torch.ones(features))

    def forward(self, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]) -> Float[Tensor, "M E"]:
        """Return the codes of standardised features and flag."""
        nothing = torch.zeros_like(self.mean)
        read = features[:, : len(self.mean)]
        return self.layers(with_flag((read - self.mean) / self.scale, valid, nothing))

    def fill_with(self, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]) -> None:
        """Set mean and scale from training cells; features that hardly vary keep their unit."""
        super().fill_with(features, valid)
        if valid.sum() > 1:
            scale = features[valid, : len(self.mean)].double().std(dim=0)
            self.scale.copy_(torch.where(scale > 1e-6, scale, torch.ones_like(scale)))


def with_flag(
    features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"], mean: Float[Tensor, " F"]
) -> Float[Tensor, "M G"]:
    """Replace missing features by the mean and append the flag (G = F + 1; docs/method.md, "Terrain features")."""
    known = torch.where(valid[:, None], features.to(mean.dtype), mean)
    flag = torch.where(valid, -1.0, 1.0).to(mean.dtype)
    return torch.cat((known, flag[:, None]), dim=-1)
