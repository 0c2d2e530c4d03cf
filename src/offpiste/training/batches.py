"""Batches of an epoch, gathered one ahead where that saves a device from waiting for the disk."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np
import torch
from jaxtyping import Int

from offpiste.dataset.feature_sets import Draw, FeatureSetChoice, drawn
from offpiste.dataset.windows import Batch, Windows
from offpiste.training.distributed import Group
from offpiste.training.mirror import Mirror

MIRRORED: Final = 0.5
"""Share of the windows that are mirrored, where any are."""

Item = TypeVar("Item")
Made = TypeVar("Made")


def draw_sets(
    draw: Draw | None, windows: Windows, index: Int[np.ndarray, " B"], rng: np.random.Generator
) -> FeatureSetChoice | None:
    """Feature sets that windows read; None for their own."""
    return drawn(draw, rng, len(index), windows.sets) if draw is not None else None


def batches_of(
    windows: Windows,
    parts: Sequence[np.ndarray],
    draw: Draw | None,
    rng: np.random.Generator,
    group: Group,
    mirror: Mirror | None = None,
) -> Iterator[Batch | None]:
    """Batches in order, of each the share of this process; None where it has none of one.

    Feature sets and what is mirrored are drawn in that order, too, however far ahead batches are gathered.

    Args:
        parts: indices of the windows of each batch.
        mirror: of half of the windows; None for none.
    """

    def gathered(index: np.ndarray) -> Batch | None:
        chosen, share = draw_sets(draw, windows, index, rng), group.share(len(index))
        images = None if mirror is None else rng.random(len(index)) < MIRRORED
        if not len(mine := index[share]):
            return None
        batch = windows.gather(mine, None if chosen is None else chosen[share])
        if mirror is None or images is None:
            return batch
        return mirror.of(batch, torch.as_tensor(images[share], device=windows.device))

    return one_ahead(gathered, parts) if windows.read_ahead else map(gathered, parts)


def one_ahead(make: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
    """What is made of items, in order, each while the one before is in use."""
    with ThreadPoolExecutor(max_workers=1) as thread:
        coming = [thread.submit(make, item) for item in items[:1]]
        for item in items[1:]:
            made = coming.pop().result()
            coming.append(thread.submit(make, item))
            yield made
        for last in coming:
            yield last.result()
