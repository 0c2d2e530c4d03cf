"""Batches of an epoch, gathered one ahead to hide reading from disk."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from jaxtyping import Int

from offpiste.dataset.feature_sets import Draw, FeatureSetChoice, drawn
from offpiste.dataset.windows import Batch, Windows
from offpiste.training.distributed import Group

Item = TypeVar("Item")
Made = TypeVar("Made")


def draw_sets(
    draw: Draw | None, windows: Windows, index: Int[np.ndarray, " B"], rng: np.random.Generator
) -> FeatureSetChoice | None:
    """Draw the feature sets that windows read; None: their own."""
    return drawn(draw, rng, len(index), windows.sets) if draw is not None else None


def batches_of(
    windows: Windows, parts: Sequence[np.ndarray], draw: Draw | None, rng: np.random.Generator, group: Group
) -> Iterator[Batch | None]:
    """Yield this process's share of each batch, given as indices of windows; None where it has no window of a batch.

    Feature sets are drawn in the same order, however far ahead batches are gathered.
    """

    def gathered(index: np.ndarray) -> Batch | None:
        chosen, share = draw_sets(draw, windows, index, rng), group.share(len(index))
        if not len(mine := index[share]):
            return None
        return windows.gather(mine, None if chosen is None else chosen[share])

    return one_ahead(gathered, parts) if windows.read_ahead else map(gathered, parts)


def one_ahead(make: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
    """Apply a function to items in order, computing the next result while the current one is in use."""
    with ThreadPoolExecutor(max_workers=1) as thread:
        results = (thread.submit(make, item) for item in items)
        coming = next(results, None)
        while coming is not None:
            made, coming = coming.result(), next(results, None)
            yield made
