"""Ground that looks like none in training: recognised by its features, and treated as ground without any."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Dynamics
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.errors import DatasetError, RunError
from offpiste.training.checkpoint import load_json, load_tensors, load_weights, save_tensors
from offpiste.training.run import Run

logger = logging.getLogger(__name__)

Novelty = Literal["ignored", "missing"]
"""What novel ground is to a model: as its encoder sees it, or ground whose features are missing."""

FILE: Final = "familiar.safetensors"
"""In the folder of a run."""


@dataclass(frozen=True)
class NoveltySettings:
    """How familiar ground is remembered.

    Attributes:
        looks: of training, how many are kept.
        neighbours: nearest looks whose mean distance counts.
        power: features are divided by their standard deviation to this power: 0 leaves them, 1 makes them all alike.
        known: share of validation's looks that count as familiar.
        candidates: looks of a part and feature set that are read at most.
        seed: of the looks that are kept.
    """

    looks: int = 1024
    neighbours: int = 3
    power: float = 0.0
    known: float = 0.99
    candidates: int = 20_000
    seed: int = 0


class Familiar(nn.Module):
    """Looks of training's ground, and how far from the nearest ones ground is still familiar.

    Args:
        looks: M, how many are kept.
        features: F, length of a look; cells may have more (`FeatureEncoder`).
    """

    kept: Tensor
    scale: Tensor
    limit: Tensor
    neighbours: Tensor

    def __init__(self, looks: int, features: int) -> None:
        super().__init__()
        self.register_buffer("kept", torch.zeros(looks, features))
        self.register_buffer("scale", torch.ones(features))
        self.register_buffer("limit", torch.tensor(torch.inf))
        self.register_buffer("neighbours", torch.tensor(1))

    def distance(self, features: Float[Tensor, "N F"]) -> Float[Tensor, " N"]:
        """Mean distance to the nearest looks, in scaled features; NaN where a feature is."""
        read = features[:, : len(self.scale)].to(self.scale.dtype) / self.scale
        apart = torch.cdist(read, self.kept, compute_mode="use_mm_for_euclid_dist")
        return apart.topk(int(self.neighbours), dim=1, largest=False).values.mean(dim=1)

    def novel(self, features: Float[Tensor, "N F"]) -> Bool[Tensor, " N"]:
        """Whether they are further away than familiar ones; false where a feature is NaN."""
        return self.distance(features) > self.limit


class Wary(FeatureEncoder):
    """An encoder to which novel ground has no features."""

    def __init__(self, encoder: FeatureEncoder, familiar: Familiar) -> None:
        super().__init__()
        self.encoder, self.familiar, self.size = encoder, familiar, encoder.size
        self.register_buffer("mean", encoder.mean)

    def forward(self, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]) -> Float[Tensor, "M E"]:
        """Codes of the encoder within."""
        known = valid.clone()
        known[valid] = ~self.familiar.novel(features[valid])
        codes: Tensor = self.encoder(features, known)
        return codes


def fit_familiar(
    training: Float[Tensor, "N F"], validation: Float[Tensor, "V F"], settings: NoveltySettings | None = None
) -> Familiar:
    """What is familiar: some looks of training, and a limit that most of validation's are within.

    Raises:
        DatasetError: either part has fewer looks than neighbours are compared.
    """
    settings = settings or NoveltySettings()
    if min(len(training), len(validation)) < settings.neighbours:
        what = f"{len(training)} looks of ground for training and {len(validation)} for validation"
        raise DatasetError(what, how="extract visual features of longer drives")
    chosen = torch.randperm(len(training), generator=torch.Generator().manual_seed(settings.seed))[: settings.looks]
    familiar = Familiar(len(chosen), training.shape[1])
    deviation = training.double().std(dim=0).float()
    familiar.scale.copy_(torch.where(deviation > 0, deviation, torch.ones_like(deviation)) ** settings.power)
    familiar.kept.copy_(training[chosen].float() / familiar.scale)
    familiar.neighbours.fill_(settings.neighbours)
    familiar.limit.copy_(familiar.distance(validation).quantile(settings.known))
    return familiar


def looks_of(dataset: Dataset, part: str, most: int) -> Float[Tensor, "N F"]:
    """Features under the wheels at starts of windows, as they were seen from all distances.

    Args:
        most: looks of each feature set.
    """
    sets, found = Windows(dataset, part).sets, list[Tensor]()
    for name in FEATURE_SETS[:sets]:
        features, valid = Windows(dataset, part, feature_set=name).features_at_starts(most)
        found.append(features[valid][:: -(-len(features[valid]) // most) or 1])
    return torch.cat(found)


def keep_familiar(run: Run, dataset: Dataset, settings: NoveltySettings | None = None) -> Familiar:
    """What is familiar to a run, as its folder keeps it, or fitted now and kept there."""
    settings = settings or NoveltySettings()
    if (run.folder / FILE).exists():
        return load_familiar(run)
    training, validation = (looks_of(dataset, part, settings.candidates) for part in ("train", "validation"))
    familiar = fit_familiar(training, validation, settings)
    weights = load_json(run.folder / "model.json")["weights_sha256"]
    save_tensors(run.folder / FILE, familiar.state_dict(), weights_sha256=weights)
    logger.info(f"familiar ground of {run.folder.name}: {len(familiar.kept)} looks, up to {float(familiar.limit):.2f}")
    return familiar


def load_familiar(run: Run) -> Familiar:
    """What is familiar to a run.

    Raises:
        RunError: nothing is kept in its folder, or it is damaged, or it belongs to other weights.
    """
    path = run.folder / FILE
    if not path.exists():
        how = "make it with `offpiste calibrate RUN --dataset DATASET`, or ignore what is novel"
        raise RunError("does not know which ground is familiar", where=run.folder, how=how)
    tensors, about = load_tensors(path)
    if about.get("weights_sha256") != load_json(run.folder / "model.json")["weights_sha256"]:
        raise RunError("belongs to other weights", where=path, how="delete it and run `offpiste calibrate` again")
    shape: Sequence[int] = tensors["kept"].shape if "kept" in tensors else (0, 0)
    familiar = Familiar(*shape)
    load_weights(familiar, tensors, path)
    return familiar


def make_wary(dynamics: Dynamics, familiar: Familiar) -> None:
    """Let a model treat novel ground as ground without features; nothing changes where it reads none."""
    if dynamics.encoder is not None:
        dynamics.encoder = Wary(dynamics.encoder, familiar)
