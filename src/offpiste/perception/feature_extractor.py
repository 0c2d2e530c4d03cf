"""Extraction of patch features by a backbone and its PCA."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, UInt8

from offpiste.native.threads import single_threaded_torch
from offpiste.perception.backbones import Backbone, open_backbone
from offpiste.perception.pca import PrincipalComponents, load_pca


@dataclass(frozen=True)
class FeatureExtractor:
    """Extractor of patch features from rectified images."""

    backbone: Backbone
    pca: PrincipalComponents

    @property
    def patch(self) -> int:
        """Side of a patch [px]."""
        return self.backbone.patch

    @property
    def channels(self) -> int:
        """Number of features per patch."""
        return self.pca.components

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(f"pca_{number}" for number in range(self.channels))

    @property
    def identity(self) -> str:
        """Hash of this PCA and backbone."""
        return self.pca.identity

    @torch.no_grad()
    def extract(self, pixels: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "rows columns F"]:
        """Extract the features of an image's patches."""
        features = self.backbone(pixels[None])[0]
        with single_threaded_torch():  # too few numbers for threads
            return np.asarray(self.pca.project(features).cpu().numpy(), np.float32)


def load_feature_extractor(path: Path, device: str = "cpu") -> FeatureExtractor:
    """Load a PCA and its backbone; raise `PerceptionError` if either is missing or they do not belong together."""
    pca = load_pca(path)
    backbone = open_backbone(pca.backbone, device=device)
    pca.check(backbone, where=path)
    return FeatureExtractor(backbone, pca)
