"""Errors by the speed at which windows start: from standstills to fast driving, and in reverse."""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool

from offpiste.evaluation.errors import HORIZONS, SeededErrors
from offpiste.evaluation.evaluated_windows import EvaluatedWindows
from offpiste.evaluation.intervals import Sampling, summary
from offpiste.evaluation.metrics import BandRow
from offpiste.evaluation.result_rows import Case

REVERSING: Final = 0.3
"""Speed backwards from which a window starts in reverse, where no gear says so [m/s]."""


class Band(NamedTuple):
    """Speeds at which windows start [m/s]."""

    name: str
    low: float
    high: float


BANDS: Final = (
    Band("0 to 1.5 m/s", 0.0, 1.5),
    Band("1.5 to 4 m/s", 1.5, 4.0),
    Band("4 to 8 m/s", 4.0, 8.0),
    Band("above 8 m/s", 8.0, np.inf),
)
"""Bands of windows that do not start in reverse."""

REVERSE: Final = "reverse"
"""Windows that start in reverse gear, or backwards where the log has no gear."""


def in_reverse(windows: EvaluatedWindows) -> Bool[np.ndarray, " n"]:
    """Windows that start in reverse, by the gear, where the dataset has one, or the velocity."""
    columns = [control.name for control in windows.dataset.rig.controls]
    backwards = windows.start_state[:, 3] < -REVERSING
    if "gear" not in columns:
        return np.asarray(backwards)
    gear = windows.at_start("control")[:, columns.index("gear")]
    return np.asarray(np.where(gear == 0, backwards, gear < 0))


def members(windows: EvaluatedWindows) -> dict[str, Bool[np.ndarray, " n"]]:
    """Which windows belong to each band; bands without any are left out."""
    reverse, speed = in_reverse(windows), windows.start_speed
    bands = {band.name: ~reverse & (speed >= band.low) & (speed < band.high) for band in BANDS} | {REVERSE: reverse}
    return {name: mine for name, mine in bands.items() if mine.any()}


def band_rows(errors: Mapping[Case, SeededErrors], windows: EvaluatedWindows, sampling: Sampling) -> list[BandRow]:
    """Distance errors of every case by band and horizon, over all its runs.

    Args:
        windows: those of the errors, which are the same in each case.
    """
    rows = []
    for name, mine in members(windows).items():
        for case, every in errors.items():
            some = every.take(np.flatnonzero(mine))
            drawn = sampling.on(some)
            rows += [
                BandRow(
                    model=case.model,
                    variant=case.variant,
                    start=case.start,
                    feature_set=case.feature_set,
                    lookup=case.lookup,
                    band=name,
                    horizon_s=float(seconds),
                    n=int(mine.sum()),
                    distance_error_m=summary(some.at(h, 0), drawn),
                    levels=drawn.levels(len(some.runs)),
                )
                for h, seconds in enumerate(HORIZONS)
            ]
    return rows
