"""Exact PCA of patch features on ground from a stream of images, stored as safetensors with a JSON header."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from safetensors import SafetensorError
from safetensors.numpy import save
from torch import Tensor

from offpiste.core.checksums import sha256_of_arrays
from offpiste.core.errors import PerceptionError
from offpiste.core.files import write_bytes
from offpiste.core.limits import open_tensors, parsed
from offpiste.core.shipped import pca_file
from offpiste.perception.backbones import Backbone

COMPONENTS = 40  # number of components, as in the paper
IMAGES = 175  # default number of images for a PCA, as in the paper


@dataclass(frozen=True)
class Moments:
    """Count, mean and scatter (sum of outer products of deviations) of vectors in float64."""

    count: int
    mean: Float[np.ndarray, " C"]
    scatter: Float[np.ndarray, "C C"]

    @classmethod
    def none(cls, channels: int) -> "Moments":
        """Return the moments of no vectors."""
        return cls(0, np.zeros(channels), np.zeros((channels, channels)))

    @classmethod
    def of(cls, vectors: Float[np.ndarray | Tensor, "n C"]) -> "Moments":
        """Return the moments of vectors; raise `PerceptionError` if one is not finite."""
        rows = np.asarray(torch.as_tensor(vectors).detach().cpu().double())
        if not len(rows):
            return cls.none(rows.shape[1])
        mean = rows.mean(axis=0)
        if not np.isfinite(mean).all():
            raise PerceptionError("features to be reduced are not finite", how="check the images they come from")
        deviation = rows - mean
        return cls(len(rows), mean, deviation.T @ deviation)

    def __add__(self, other: "Moments") -> "Moments":
        """Return the moments of both sets of vectors (Chan, Golub, LeVeque, "Updating Formulae ...", 1979)."""
        count = self.count + other.count
        if not count:
            return self
        apart = other.mean - self.mean
        scatter = self.scatter + other.scatter + np.outer(apart, apart) * (self.count * other.count / count)
        return Moments(count, self.mean + apart * (other.count / count), scatter)

    def add(self, features: Float[Tensor, "*P C"], ground: Bool[np.ndarray | Tensor, "*P"]) -> "Moments":
        """Add the patches of feature images that ground points hit."""
        return self + Moments.of(features[torch.as_tensor(ground, device=features.device)])


@dataclass(frozen=True)
class PrincipalComponents:
    """Linear map from a backbone's features to their principal components, largest variance first."""

    mean: Float[np.ndarray, " C"]  # of the features
    basis: Float[np.ndarray, "C n"]  # orthonormal columns with a positive largest entry, so that signs are reproducible
    variance: Float[np.ndarray, " n"]  # explained by each column
    total_variance: float  # of the features
    backbone: str
    fingerprint: str  # `Backbone.fingerprint`
    fitted_on: Mapping[str, Any] = field(default_factory=dict)  # number of patches, logs, split ...

    @property
    def components(self) -> int:
        """Number of components, n."""
        return self.basis.shape[1]

    @property
    def identity(self) -> str:
        """Hash of the map, stored with its features."""
        digest = hashlib.sha256(self.fingerprint.encode())
        for part in (self.mean, self.basis):
            digest.update(np.ascontiguousarray(part, dtype="<f4").tobytes())
        return digest.hexdigest()[:16]

    def project(self, features: Float[Tensor, "*P C"]) -> Float[Tensor, "*P n"]:
        """Return the components of features on their device."""
        mean, basis = (torch.from_numpy(part).to(features) for part in (self.mean, self.basis))
        return (features - mean) @ basis

    def check(self, backbone: Backbone, *, where: str | Path = "") -> None:
        """Raise `PerceptionError` for a backbone with other features; `where` is the PCA's file, for the message."""
        if backbone.fingerprint != self.fingerprint or len(self.mean) != backbone.channels:
            raise PerceptionError(
                f"the PCA was fitted on features of {self.backbone} ({self.fingerprint}), "
                f"the backbone in use is {backbone.name} ({backbone.fingerprint})",
                where=where,
                how="use that backbone, or run `offpiste fit-pca` with this one",
            )


def fit(moments: Moments, backbone: Backbone, *, components: int = COMPONENTS, **fitted_on: Any) -> PrincipalComponents:
    """Compute a PCA from moments; raise `PerceptionError` for fewer than two patches, or equal ones.

    It has fewer than `components` if the patches span fewer directions (few patches, few or constant channels).
    """
    if moments.count < 2:
        raise PerceptionError(
            f"{moments.count} ground patches in the images, too few for a PCA",
            how="check that LiDAR points project into the images (`offpiste inspect`)",
        )
    values, vectors = np.linalg.eigh(moments.scatter / (moments.count - 1))
    values, vectors = values[::-1], vectors[:, ::-1]
    # Variance that float32 features can tell from zero.
    spread = values > max(values[0], 0.0) * np.finfo(np.float32).eps * 1e-2
    kept = min(components, int(spread.sum()) if values[0] > 0 else 0, moments.count - 1)
    if not kept:
        raise PerceptionError("all ground patches are equal", how="check that the images show ground")
    basis = vectors[:, :kept]
    basis = basis * np.sign(basis[np.abs(basis).argmax(axis=0), np.arange(kept)])
    return PrincipalComponents(
        mean=moments.mean.astype(np.float32),
        basis=basis.astype(np.float32),
        variance=values[:kept].astype(np.float32),
        total_variance=float(values.clip(0).sum()),
        backbone=backbone.name,
        fingerprint=backbone.fingerprint,
        fitted_on={"patches": moments.count, **fitted_on},
    )


PCA_HEADER = "offpiste_pca"  # key of the JSON in the file's header

_SCHEMA = 1
_TENSORS = ("mean", "basis", "variance")


def save_pca(path: Path, pca: PrincipalComponents) -> None:
    """Write a PCA with its digest atomically."""
    names = ("total_variance", "backbone", "fingerprint", "fitted_on")
    tensors = {name: np.array(getattr(pca, name), order="C") for name in _TENSORS}
    about = json.loads(json.dumps({"schema": _SCHEMA} | {name: getattr(pca, name) for name in names}))
    header = {PCA_HEADER: json.dumps({**about, "sha256": sha256_of_arrays(tensors, about)})}
    write_bytes(path, save(tensors, metadata=header))  # safetensors' own writer hides that a disk is full


def load_pca(path: str | Path) -> PrincipalComponents:
    """Read a PCA from its file, or from `pretrained:FAMILY`; raise `PerceptionError` for anything else."""
    path = pca_file(path)
    try:
        with open_tensors(path, "numpy") as file:
            header = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in _TENSORS}
        about = parsed(header[PCA_HEADER])
        written = about.pop("sha256")
        if about["schema"] != _SCHEMA:
            raise ValueError(f"schema {about['schema']}, not {_SCHEMA}")
        if written != sha256_of_arrays(tensors, about):
            raise ValueError("damaged: its checksum differs")
        mean, basis, variance = (tensors[name].shape for name in _TENSORS)
        if len(basis) != 2 or not min(basis) or mean != basis[:1] or variance != basis[1:]:
            raise ValueError(f"mean, basis and variance of shapes {mean}, {basis}, {variance} do not fit together")
        if not all(values.dtype == np.float32 and np.isfinite(values).all() for values in tensors.values()):
            raise ValueError("mean, basis or variance is not finite float32")
        return PrincipalComponents(
            **tensors,
            total_variance=float(about["total_variance"]),
            backbone=str(about["backbone"]),
            fingerprint=str(about["fingerprint"]),
            fitted_on=dict(about["fitted_on"]),
        )
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        how = "give the file that `offpiste fit-pca` wrote"
        raise PerceptionError(f"not a PCA of offpiste ({reason})", where=path, how=how) from error
