"""What an illness does to the rows that a model trains on: their distance from the healthy log's, and its cost."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from experiments.illnesses.quick_model import error_of, fit, windows_of
from experiments.illnesses.recording import Case
from offpiste.core.conventions import DT
from offpiste.core.errors import OffpisteError
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.logs.drive import drive_from_log
from offpiste.rig.rig import Vehicle

_LARGEST: Final = 2.0
"""Difference of one row over the column's spread beyond which it counts no more."""
_SHIFTS: Final = np.arange(-75, 76, 5)
"""Shifts of a whole log that are tried [rows]: a clock that all topics share does not matter."""
_NOISE: Final = 0.03
"""Distance that is within the noise of the sensors."""
_LEFT: Final = 0.25
"""A cure is right if it leaves at most this share of the distance."""
_TRAINED: Final = 0.7
"""Share of a log that the quick model is fitted to; it is evaluated on the rest."""
FEW, MANY = 60, 300
"""Windows of the quick and of the exact measure: others of the same healthy log change the error by 2 % in the middle
and by 6 % in one of ten logs with few, by 0.5 % and 2 % with many (`detectability`)."""
UNREADABLE: Final = 1e6
"""Cost of a log that cannot be read, or that has too few windows; no model is worse than that."""


@dataclass(frozen=True)
class Readable:
    """Rows of a case, with the vehicle that its rig describes."""

    rows: Rows
    vehicle: Vehicle


def rows_of(case: Case) -> Readable | None:
    """The rows that a case would train a model with; None where it cannot be read."""
    try:
        return Readable(extract_rows(drive_from_log(case.log, case.rig)), case.rig.vehicle)
    except OffpisteError:
        return None


def quantities(readable: Readable) -> Float[np.ndarray, "N q"]:
    """What a model reads, free of the world's frame and of how curvature is split between the rig's numbers.

    Columns: displacement over 1 s in the body's frame, turn over 1 s, vx, vy, yaw rate, throttle, brake, curvature by
    the commanded and by the measured steering, its rate, brake pressure, engine speed.
    """
    rows, vehicle = readable.rows, readable.vehicle
    state = rows.state.astype(np.float64)
    state[~rows.valid] = np.nan
    control, actuators = rows.control.astype(np.float64), rows.actuators.astype(np.float64)
    ahead = round(1 / DT)
    step = np.full((len(state), 3), np.nan)
    step[:-ahead] = state[ahead:, :3] - state[:-ahead, :3]
    cos, sin = np.cos(state[:, 2]), np.sin(state[:, 2])
    along, across = cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0]

    def curvature(angle: np.ndarray) -> np.ndarray:
        return np.asarray(np.tan(np.clip(angle, -1.4, 1.4)) / vehicle.wheelbase)

    return np.column_stack(
        (
            along,
            across,
            step[:, 2],
            state[:, 3:],
            control[:, :2],
            curvature(vehicle.max_steer * control[:, 2]),
            curvature(actuators[:, 1]),
            actuators[:, [0, 2, 3]],
        )
    )


def distance(sick: Readable | None, healthy: Readable) -> float:
    """The largest of the columns' RMS differences from the healthy rows over a column's spread; 0 to `_LARGEST`.

    Rows and columns that the sick log lacks count as far away, unless the healthy log lacks them too.
    """
    if sick is None:
        return _LARGEST
    true, values = quantities(healthy), quantities(sick)
    row = np.round((healthy.rows.time - sick.rows.time[0]) / DT).astype(int)
    known = np.isfinite(true)
    spread = np.array([np.std(column[k]) if k.any() else 0.0 for column, k in zip(true.T, known.T, strict=True)]) + 1e-6
    # Vectors have one scale: a vehicle that does not slide has hardly any vy, and its noise is not an effect.
    for vector in (slice(0, 2), slice(3, 5)):
        spread[vector] = spread[vector].max()
    best = np.inf
    for shift in sorted(_SHIFTS, key=abs):
        moved = row + shift
        inside = (moved >= 0) & (moved < len(values))
        compared = np.full(true.shape, np.nan)
        compared[inside] = values[moved[inside]]
        best = min(best, _difference(compared, true, known, spread))
        if best < _NOISE:
            break
    return best


def _difference(values: np.ndarray, true: np.ndarray, known: np.ndarray, spread: np.ndarray) -> float:
    """The largest of the columns' RMS differences, each row's limited."""
    with np.errstate(invalid="ignore"):
        away = np.minimum(np.abs(values - true) / spread, _LARGEST)
    away = np.where(np.isfinite(away), away, _LARGEST)
    columns = [np.sqrt(np.mean(a[k] ** 2)) for a, k in zip(away.T, known.T, strict=True) if k.any()]
    return float(np.max(columns))


def is_cured(left: float, ill: float) -> bool:
    """Whether a distance that is left counts as healthy, given that of the illness."""
    return left <= max(_LEFT * ill, _NOISE)


@dataclass(frozen=True)
class Costs:
    """Errors of quick models, all evaluated on the last part of one log.

    Attributes:
        evaluated: that log, the healthy one or the healthy one by the conventions of a case.
        healthy: error of a model fitted to the first part of the healthy log, on the last part of it [m].
        windows: that a model is fitted to, and evaluated on, at the most.
    """

    evaluated: Readable
    healthy: float
    windows: int

    def of(self, case: Case) -> float | None:
        """Error of a model fitted to the first part of another case over that of the healthy log, minus 1.

        `UNREADABLE` where the case cannot be read or holds too few windows, None where the healthy log does.
        """
        return self.of_rows(rows_of(case))

    def of_rows(self, readable: Readable | None) -> float | None:
        """The same for rows that are read already."""
        if not np.isfinite(self.healthy):
            return None
        return min(error_after(readable, self.evaluated, self.windows) / self.healthy - 1, UNREADABLE)


def costs_against(healthy: Readable, evaluated: Readable | None = None, *, windows: int = FEW) -> Costs:
    """Costs of cases against their healthy log, evaluated there or on another one."""
    return Costs(evaluated or healthy, error_after(healthy, healthy, windows), windows)


def error_after(trained: Readable | None, evaluated: Readable, windows: int, *, begin: float = -np.inf) -> float:
    """Error after 5 s of a quick model on the last part of a log [m]; infinite where there are too few windows.

    Args:
        trained: what it is fitted to, up to that part's beginning.
        windows: that it is fitted to, and evaluated on, at the most.
        begin: time from which on it is fitted [s].
    """
    start, end = evaluated.rows.time[[0, -1]]
    split = start + _TRAINED * (end - start)
    if trained is None:
        return np.inf
    first = windows_of(trained.rows, trained.vehicle, first=begin, last=split, most=windows)
    last = windows_of(evaluated.rows, evaluated.vehicle, first=split, last=np.inf, most=windows)
    if first is None or last is None:
        return np.inf
    model = fit(first, trained.vehicle.wheelbase)
    return error_of(model, last, evaluated.vehicle.wheelbase)
