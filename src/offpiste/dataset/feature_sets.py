"""Which feature set each trajectory reads, and how training draws it (paper, "Distance-Independent Training")."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from offpiste.conventions import FEATURE_SETS, HISTORY_STEPS
from offpiste.errors import DatasetError


@dataclass(frozen=True)
class FeatureSetChoice:
    """Feature sets of a batch of windows.

    Attributes:
        sets: by window and row t-10 ... t+T-1; one column: the same for the whole window.
        flags_only: features are hindsight's, and missing where the set lacks them.
    """

    sets: Int[np.ndarray, "B R"]
    flags_only: bool = False


def same_feature_set(count: int, number: int) -> FeatureSetChoice:
    """All windows read one set."""
    return FeatureSetChoice(np.full((count, 1), number))


def set_number(name: str, stored: int) -> int:
    """Number of a feature set in a dataset that stores `stored` of them.

    Raises:
        DatasetError: no such set, or the dataset has one feature set only.
    """
    if name not in FEATURE_SETS:
        raise DatasetError(f"no feature set '{name}'", how=f"sets are {', '.join(FEATURE_SETS)}")
    number = FEATURE_SETS.index(name)
    if number >= stored:
        raise DatasetError(
            f"has no feature sets by distance, so no set '{name}'", how="extract visual features (`extract --pca`)"
        )
    return number


Draw = Callable[[np.random.Generator, int, int, int], FeatureSetChoice]
"""From a generator, the number of windows, of their predicted steps and of the stored sets to what the windows read."""


def per_trajectory(rng: np.random.Generator, count: int, horizon: int, stored: int) -> FeatureSetChoice:
    """`dc`: one of the seven distances or hindsight for each window, kept for the whole of it."""
    return FeatureSetChoice(rng.integers(0, stored, (count, 1)))


def per_step(rng: np.random.Generator, count: int, horizon: int, stored: int) -> FeatureSetChoice:
    """`dc-step`: drawn anew at every step; the paper found it poor."""
    return FeatureSetChoice(rng.integers(0, stored, (count, HISTORY_STEPS + horizon)))


def masked(rng: np.random.Generator, count: int, horizon: int, stored: int) -> FeatureSetChoice:
    """`cf-masked`: what would be missing from a drawn distance is, but the rest is as in hindsight."""
    return FeatureSetChoice(rng.integers(0, stored, (count, 1)), flags_only=True)
