"""Several runs of one model as one result: averaged over seeds, put side by side over folds."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from offpiste.evaluation.judge import Errors


def pool(runs: Sequence[Errors]) -> Errors:
    """Each window's error is the mean over the runs that judged it; windows in ascending order.

    Seeds judge the same windows, so their errors are averaged window by window; folds judge disjoint ones, so theirs
    are put together. What is averaged are errors, never predictions: an ensemble would be another model. A window in
    which one of the runs failed has failed.
    """
    keys, place = np.unique(np.concatenate([run.key for run in runs]), return_inverse=True)
    count = np.bincount(place).astype(float)
    values = np.zeros((len(keys), *runs[0].values.shape[1:]))
    loss = np.zeros(len(keys))
    np.add.at(values, place, np.concatenate([run.values for run in runs]))
    np.add.at(loss, place, np.concatenate([run.loss for run in runs]))
    return Errors(keys >> 32, keys & 0xFFFFFFFF, values / count[:, None, None], loss / count)


def positions(windows: Errors, among: Errors) -> Int[np.ndarray, " n"]:
    """Where each of the windows stands in `among`, which has them all in ascending order."""
    found = np.searchsorted(among.key, windows.key)
    assert np.array_equal(among.key[np.minimum(found, len(among.key) - 1)], windows.key), "not the same windows"
    return np.asarray(found)
