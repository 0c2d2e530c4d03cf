"""Where models read the ground: under the recorded wheels or on a map, and from which distance it was seen."""

from collections.abc import Sequence

import numpy as np

from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.tabulate import REFERENCE, Lookup

GROUND_BLIND = ("ctrv", REFERENCE)
"""Models that do not read the ground: there is nothing to look up."""

Way = tuple[Lookup | None, str | None]
"""Where a model reads the ground, and from which distance it was seen."""

NO_WAY: Way = (None, None)


def ways_of(dataset: Dataset, part: str, lookups: Sequence[Lookup], feature_sets: Sequence[str]) -> Sequence[Way]:
    """Where models can read the ground: features without a map only where they were recorded.

    Args:
        part: whose windows are judged.
        lookups, feature_sets: that are asked for.
    """
    if not _has_ground(dataset):
        return (NO_WAY,)
    windows = Windows(dataset, part)
    mapped = not dataset.features or windows.maps.any
    sets = tuple(feature_sets) if windows.sets > 1 else (None,)
    recorded: list[Way] = [("recorded", chosen) for chosen in sets] if "recorded" in lookups or not mapped else []
    on_map: list[Way] = [("map", None)] if "map" in lookups and mapped else []
    return recorded + on_map


def _has_ground(dataset: Dataset) -> bool:
    """Whether there is anything to read from the ground."""
    return bool(dataset.features) or any(
        bool(np.nanmax(np.abs(drive.rows.normal[..., :2]), initial=0) > 0) for drive in dataset.drives
    )
