"""Which feature set each trajectory reads (paper, "Distance-Independent Training")."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from offpiste.conventions import FEATURE_SETS
from offpiste.errors import DatasetError


@dataclass(frozen=True)
class Views:
    """Feature sets of a batch of windows.

    Attributes:
        sets: by window and row t-10 ... t+T-1; one column: the same for the whole window.
        flags_only: features are hindsight's, and missing where the set lacks them.
    """

    sets: Int[np.ndarray, "B R"]
    flags_only: bool = False


def same_view(count: int, number: int) -> Views:
    """All windows read one set."""
    return Views(np.full((count, 1), number))


def set_number(name: str, stored: int) -> int:
    """Number of a feature set in a dataset that stores so many.

    Raises:
        DatasetError: no such set, or the dataset has views from one distance only.
    """
    if name not in FEATURE_SETS:
        raise DatasetError(f"no feature set '{name}'", how=f"sets are {', '.join(FEATURE_SETS)}")
    number = FEATURE_SETS.index(name)
    if number >= stored:
        raise DatasetError(
            f"holds no views by distance, so no set '{name}'", how="extract visual features (`extract --pca`)"
        )
    return number
