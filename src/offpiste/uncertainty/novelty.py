"""Novel ground, unlike any in training: detected by its features, and treated as ground without features."""

import logging
import math
from collections.abc import Sequence
from typing import Final, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import DatasetError, RunError
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Dynamics
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.training.checkpoint import load_beside_weights, load_weights, save_beside_weights
from offpiste.training.run import Run

logger = logging.getLogger(__name__)

Novelty = Literal["ignored", "missing"]
"""Treatment of novel ground: encoded like other ground, or as ground with missing features."""

FILE: Final = "memory_bank.safetensors"
"""File with the memory bank, in the folder of a run."""


SIZE, CANDIDATES = 1024, 20_000
"""Number of training cells whose features are stored, and largest number read per part and feature set."""
NEIGHBOURS: Final = 3
"""Number of nearest stored features whose mean distance is used."""
KNOWN: Final = 0.99
"""Share of validation cells that count as known."""


class MemoryBank(nn.Module):
    """Features of training ground, with a distance threshold for novel ground (Roth et al., PatchCore, 2022).

    Args:
        size: number of stored cells M.
        features: number of features F; cells may have more (`FeatureEncoder`).
    """

    kept: Tensor
    scale: Tensor
    limit: Tensor
    neighbours: Tensor

    def __init__(self, size: int, features: int) -> None:
        super().__init__()
        self.register_buffer("kept", torch.zeros(size, features))
        self.register_buffer("scale", torch.ones(features))
        self.register_buffer("limit", torch.tensor(torch.inf))
        self.register_buffer("neighbours", torch.tensor(1))

    def distance(self, features: Float[Tensor, "N F"]) -> Float[Tensor, " N"]:
        """Return the mean distance to the nearest stored features, scaled; NaN if a feature is NaN."""
        read = features[:, : len(self.scale)].to(self.scale.dtype) / self.scale
        apart = torch.cdist(read, self.kept, compute_mode="use_mm_for_euclid_dist")
        return apart.topk(int(self.neighbours), dim=1, largest=False).values.mean(dim=1)

    def novel(self, features: Float[Tensor, "N F"]) -> Bool[Tensor, " N"]:
        """Return whether features are beyond the threshold; false if a feature is NaN."""
        return self.distance(features) > self.limit


class NoveltyMask(FeatureEncoder):
    """Encoder that treats novel ground as ground without features."""

    def __init__(self, encoder: FeatureEncoder, bank: MemoryBank) -> None:
        super().__init__()
        self.encoder, self.bank, self.size = encoder, bank, encoder.size
        self.register_buffer("mean", encoder.mean)

    def forward(self, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]) -> Float[Tensor, "M E"]:
        """Return the codes of the wrapped encoder."""
        known = valid.clone()
        known[valid] = ~self.bank.novel(features[valid])
        codes: Tensor = self.encoder(features, known)
        return codes


def fit_memory_bank(training: Float[Tensor, "N F"], validation: Float[Tensor, "V F"]) -> MemoryBank:
    """Choose features of training, and a threshold that most validation features are below.

    Raises:
        DatasetError: a part has fewer cells than `NEIGHBOURS`.
    """
    if min(len(training), len(validation)) < NEIGHBOURS:
        what = f"{len(training)} cells of ground for training and {len(validation)} for validation"
        raise DatasetError(what, how="extract visual features of longer drives")
    chosen = torch.randperm(len(training), generator=torch.Generator().manual_seed(0))[:SIZE]
    bank = MemoryBank(len(chosen), training.shape[1])
    bank.kept.copy_(training[chosen].float())
    bank.neighbours.fill_(NEIGHBOURS)
    bank.limit.copy_(bank.distance(validation).quantile(KNOWN))
    return bank


def features_at_starts(dataset: Dataset, part: str, most: int) -> Float[Tensor, "N F"]:
    """Return features under the wheels at the starts of windows, of all feature sets.

    Args:
        most: largest number of cells per feature set.
    """
    windows, seen = Windows(dataset, part), list[Tensor]()
    for name in FEATURE_SETS[: windows.sets]:
        features, valid = windows.with_feature_set(name).features_at_starts(most)
        known = features[valid]
        seen.append(known[:: max(math.ceil(len(known) / most), 1)])
    return torch.cat(seen)


def keep_memory_bank(run: Run, dataset: Dataset) -> MemoryBank:
    """Read the memory bank in a run's folder; if there is none, make and store it."""
    if (run.folder / FILE).exists():
        return load_memory_bank(run)
    bank = fit_memory_bank(*(features_at_starts(dataset, part, CANDIDATES) for part in ("train", "validation")))
    save_beside_weights(run.folder / FILE, bank.state_dict())
    known = f"{len(bank.kept)} cells, up to a distance of {float(bank.limit):.2f}"
    logger.info(f"known ground of {run.folder.name}: {known}")
    return bank


def load_memory_bank(run: Run) -> MemoryBank:
    """Read the memory bank in a run's folder.

    Raises:
        RunError: there is none, it is damaged, or it belongs to other weights.
    """
    path = run.folder / FILE
    if not path.exists():
        how = "make it with `offpiste calibrate RUN --dataset DATASET`, or ignore novel ground"
        raise RunError("has no memory bank to detect novel ground", where=run.folder, how=how)
    tensors, _ = load_beside_weights(path)
    shape: Sequence[int] = tensors["kept"].shape if "kept" in tensors else (0, 0)
    bank = MemoryBank(*shape)
    load_weights(bank, tensors, path)
    return bank


def mask_novel_ground(dynamics: Dynamics, bank: MemoryBank) -> None:
    """Make a model treat novel ground as ground without features; no effect if it reads no features."""
    if dynamics.encoder is not None:
        dynamics.encoder = NoveltyMask(dynamics.encoder, bank)
