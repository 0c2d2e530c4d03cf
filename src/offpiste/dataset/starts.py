"""Where windows start: complete, in one part, fast enough, and on ground that was seen."""

import numpy as np
from jaxtyping import Bool, Int

from offpiste.conventions import HORIZON_STEPS, MIN_JUDGED_SPEED
from offpiste.dataset.extract import Rows
from offpiste.dataset.hindsight import enough_hindsight
from offpiste.dataset.splits import window_starts


def judged_starts(
    rows: Rows,
    mine: Bool[np.ndarray, " N"],
    min_hindsight: float = 0.0,
    min_speed: float = MIN_JUDGED_SPEED,
    horizon: int = HORIZON_STEPS,
) -> Int[np.ndarray, " n"]:
    """Rows t of a drive at which windows start.

    Args:
        mine: rows that belong to the part.
        min_hindsight: of `dataset.hindsight`.
        min_speed: of the causal estimate at t [m/s].
        horizon: predicted steps.
    """
    found = window_starts(rows.valid & mine, horizon=horizon)
    found = found[np.hypot(rows.state_causal[found, 3], rows.state_causal[found, 4]) > min_speed]
    enough = enough_hindsight(rows.cells, min_hindsight, horizon=horizon)
    return found if enough is None else found[enough[found]]
