"""Which feature sets a model reads while it trains (paper, "Distance-Independent Training"), by its name."""

from collections.abc import Callable

import numpy as np

from offpiste.conventions import HISTORY_STEPS
from offpiste.dataset.views import Views

Draw = Callable[[np.random.Generator, int, int, int], Views]
"""From a generator, the number of windows, of their predicted steps and of the stored sets to what the windows read."""


def per_trajectory(rng: np.random.Generator, count: int, horizon: int, stored: int) -> Views:
    """`dc`: one of the seven distances or hindsight for each window, kept for the whole of it."""
    return Views(rng.integers(0, stored, (count, 1)))


def per_step(rng: np.random.Generator, count: int, horizon: int, stored: int) -> Views:
    """`dc-step`: drawn anew at every step; the paper found it poor."""
    return Views(rng.integers(0, stored, (count, HISTORY_STEPS + horizon)))


def masked(rng: np.random.Generator, count: int, horizon: int, stored: int) -> Views:
    """`cf-masked`: what would be missing from a drawn distance is, but the rest is as in hindsight."""
    return Views(rng.integers(0, stored, (count, 1)), flags_only=True)


DRAWS: dict[str, Draw] = {"dc": per_trajectory, "dc-hold": per_trajectory, "dc-step": per_step, "cf-masked": masked}
"""Models that are not trained on hindsight alone."""
