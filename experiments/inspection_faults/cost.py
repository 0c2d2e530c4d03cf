"""Effect of a fault on the rows that a model trains on: their distance from the healthy log's, and its cost.

The cost is the error after 5 s of a quick model fitted to the first part of a log, on the last part of the healthy log,
relative to the healthy log's. The model is a bicycle with understeer and pedals behind a lag: eight constants, fitted
by least squares. It knows no terrain; what counts is how much worse it gets.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from experiments.inspection_faults.recording import Case
from offpiste.core.conventions import DT, GRAVITY, HORIZON_STEPS
from offpiste.core.errors import OffpisteError
from offpiste.core.geometry import planar_body_from_world
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.logs.drive import drive_from_log
from offpiste.rig.rig import Vehicle

COSTLY: Final = 0.05
"""Cost from which on a fault matters: 5 % of the error after five seconds."""
UNREADABLE: Final = 1e6
"""Cost of a log that cannot be read or has too few windows."""
_LARGEST: Final = 2.0
"""Largest counted difference of a row, relative to the column's spread."""
_SHIFTS: Final = sorted(range(-75, 76, 5), key=abs)
"""Tried shifts of a whole log [rows]: a delay shared by all topics does not matter."""
_NOISE, _LEFT = 0.03, 0.25
"""A fix is right if the distance is within the sensors' noise, or at most this share of the fault's."""
_TRAINED: Final = 0.7
"""Share of a log that the quick model is fitted to."""
_WINDOWS, _LEAST_WINDOWS = 300, 4
"""With 300 windows, others of the same healthy log change the error by 0.5 % (median)."""
_EVERY: Final = 5
_STEPS: Final = HORIZON_STEPS // _EVERY
"""Rows of a step of the quick model (0.1 s), and steps of a window."""
_START: Final = np.array((1.0, 0.05, 0.0, 0.2, 1.0, 1.0, 0.05, 0.2))
"""Steering gain, understeer, centre, lag of the turning; accelerations of the pedals, drag, rolling resistance.

Lengths and times are in units of the wheelbase and its Froude time, so that one start fits all sizes."""
_DIFFERENCE: Final = 1e-6
"""Step of the finite differences."""


@dataclass(frozen=True)
class Readable:
    """Rows of a case, with the vehicle that its rig describes."""

    rows: Rows
    vehicle: Vehicle


def rows_of(case: Case) -> Readable | None:
    """Return the rows that a case would train a model with; None where it cannot be read."""
    try:
        return Readable(extract_rows(drive_from_log(case.log, case.rig)), case.rig.vehicle)
    except OffpisteError:
        return None


def _quantities(readable: Readable) -> Float[np.ndarray, "N q"]:
    """What a model reads, independent of the world frame and of how curvature is split between the rig's numbers.

    Columns: displacement over 1 s in the body frame, turn over 1 s, vx, vy, yaw rate, throttle, brake, curvature by the
    commanded and by the measured steering, its rate, brake pressure, engine speed.
    """
    rows, vehicle, ahead = readable.rows, readable.vehicle, round(1 / DT)
    state = np.where(rows.valid[:, None], rows.state, np.nan).astype(np.float64)
    control, actuators = rows.control.astype(np.float64), rows.actuators.astype(np.float64)
    step = np.full((len(state), 3), np.nan)
    step[:-ahead] = state[ahead:, :3] - state[:-ahead, :3]
    angles = np.column_stack((vehicle.max_steer * control[:, 2], actuators[:, 1]))
    curvature = np.tan(np.clip(angles, -1.4, 1.4)) / vehicle.wheelbase
    moved = planar_body_from_world(step[:, :2], state[:, 2])
    return np.column_stack((moved, step[:, 2], state[:, 3:], control[:, :2], curvature, actuators[:, [0, 2, 3]]))


def distance(faulty: Readable | None, healthy: Readable) -> float:
    """Return the largest RMS difference of a column from the healthy rows, relative to its spread.

    Rows and columns that the faulty log lacks count as far away, unless the healthy log lacks them too.
    """
    if faulty is None:
        return _LARGEST
    true, values = _quantities(healthy), _quantities(faulty)
    row = np.round((healthy.rows.time - faulty.rows.time[0]) / DT).astype(int)
    known = np.isfinite(true)
    spread = np.array([np.std(column[k]) if k.any() else 0.0 for column, k in zip(true.T, known.T, strict=True)]) + 1e-6
    for vector in (slice(0, 2), slice(3, 5)):  # the noise of vy of a vehicle that does not slide is no effect
        spread[vector] = spread[vector].max()
    best = np.inf
    for shift in _SHIFTS:
        inside = (row + shift >= 0) & (row + shift < len(values))
        away = np.full(true.shape, np.nan)
        away[inside] = np.abs(values[(row + shift)[inside]] - true[inside]) / spread
        away = np.minimum(np.where(np.isfinite(away), away, _LARGEST), _LARGEST)
        columns = [np.sqrt(np.mean(a[k] ** 2)) for a, k in zip(away.T, known.T, strict=True) if k.any()]
        best = min(best, float(np.max(columns)))
        if best < _NOISE:
            break
    return best


def is_fixed(left: float, before: float) -> bool:
    """Whether a remaining distance counts as healthy, given that of the fault."""
    return left <= max(_LEFT * before, _NOISE)


@dataclass(frozen=True)
class Windows:
    """Windows of W starts and S steps."""

    start: Float[np.ndarray, "W 6"]  # x, y, yaw, vx, vy, yaw_rate [m, rad, m/s, rad/s]
    throttle: Float[np.ndarray, "S W"]  # held over each step
    brake: Float[np.ndarray, "S W"]
    angle: Float[np.ndarray, "S W"]  # of the road wheels [rad]
    place: Float[np.ndarray, "S W 2"]  # after each step [m]
    wheelbase: float  # [m]


def _windows(readable: Readable, first: float, last: float) -> Windows | None:
    """Windows of valid rows between two times [s] in which the vehicle moves; None if there are too few."""
    rows, vehicle = readable.rows, readable.vehicle
    broken = np.append(0, np.cumsum(~(rows.valid & (rows.time >= first) & (rows.time <= last))))
    starts = np.arange(0, len(rows.time) - HORIZON_STEPS - 1, _EVERY)
    fast = np.hypot(*rows.state[starts, 3:5].T) > 0.3 * np.sqrt(vehicle.wheelbase)
    starts = starts[(broken[starts + HORIZON_STEPS + 1] == broken[starts]) & fast]
    if len(starts) < _LEAST_WINDOWS:
        return None
    starts = starts[np.unique(np.linspace(0, len(starts) - 1, _WINDOWS).astype(int))]
    # The mean command over a step's rows, as short pulses would alias.
    within = starts[None, :, None] + _EVERY * np.arange(_STEPS)[:, None, None] + np.arange(_EVERY)
    control = np.nan_to_num(rows.control[within].mean(axis=2).astype(np.float64))
    after = starts[None] + _EVERY * np.arange(1, _STEPS + 1)[:, None]
    start, place = rows.state[starts].astype(np.float64), rows.state[after][..., :2].astype(np.float64)
    angle = vehicle.max_steer * control[..., 2]
    return Windows(start, control[..., 0], control[..., 1], angle, place, vehicle.wheelbase)


def _rolled_out(constants: Float[np.ndarray, "k 8"], windows: Windows) -> Float[np.ndarray, "S k W 2"]:
    """Places after each step [m] for several sets of constants."""
    gain, understeer, centre, lag, pull, stop, drag, rolling = (constants[:, i, None] for i in range(8))
    wheelbase, unit, dt = windows.wheelbase, np.sqrt(windows.wheelbase / GRAVITY), DT * _EVERY
    shape = (len(constants), len(windows.start))
    x, y, yaw, v, side, rate = (np.broadcast_to(column, shape) for column in windows.start.T)
    keep = np.exp(-dt / (unit * np.maximum(np.abs(lag), 1e-2)))
    places = np.empty((_STEPS, *shape, 2))
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(_STEPS):
            curvature = gain * np.tan(np.clip(windows.angle[step] + centre, -1.4, 1.4)) / wheelbase
            lateral = v * v * unit**2 / wheelbase**2
            rate = keep * rate + (1 - keep) * v * curvature / (1 + np.abs(understeer) * lateral)
            motion = np.clip(v / (0.3 * wheelbase / unit), -1, 1)
            force = pull * windows.throttle[step] - (5 * stop * windows.brake[step] + rolling) * motion
            v = np.clip(v + dt * (force - drag * v * unit / wheelbase * GRAVITY), -1e3, 1e3)
            side = np.exp(-dt / (2 * unit)) * side
            middle = yaw + 0.5 * dt * rate
            x = x + dt * (v * np.cos(middle) - side * np.sin(middle))
            y = y + dt * (v * np.sin(middle) + side * np.cos(middle))
            yaw = yaw + dt * rate
            places[step, ..., 0], places[step, ..., 1] = x, y
    return places


def _fitted(windows: Windows) -> Float[np.ndarray, " 8"]:
    """The constants that predict these windows best."""
    driven = float(np.median(np.hypot(*(windows.place[-1] - windows.start[:, :2]).T)))
    scale = 0.1 * max(driven, windows.wheelbase)
    some = (np.array((0.2, 0.4, 0.7, 1.0)) * _STEPS).astype(int) - 1

    def residuals(constants: np.ndarray) -> np.ndarray:
        away = np.moveaxis(_rolled_out(constants, windows)[some], 1, 0) - windows.place[some]
        return np.clip(np.nan_to_num(away / scale, nan=1e3).reshape(len(constants), -1), -1e3, 1e3)

    def slopes(constants: np.ndarray) -> np.ndarray:
        stepped = residuals(np.vstack((constants, constants + _DIFFERENCE * np.eye(8))))
        return np.asarray((stepped[1:] - stepped[0]).T / _DIFFERENCE)

    fit = least_squares(lambda c: residuals(c[None])[0], _START, jac=slopes, loss="soft_l1", max_nfev=25)
    return np.asarray(fit.x)


def error_after(trained: Readable | None, evaluated: Readable) -> float:
    """Error after 5 s of a quick model on the last part of a log [m]; infinite where there are too few windows."""
    start, end = evaluated.rows.time[[0, -1]]
    split = start + _TRAINED * (end - start)
    first = None if trained is None else _windows(trained, -np.inf, split)
    last = _windows(evaluated, split, np.inf)
    if first is None or last is None:
        return np.inf
    away = _rolled_out(_fitted(first)[None], last)[-1, 0] - last.place[-1]
    return float(np.mean(np.hypot(*away.T)))


def cost_of(faulty: Readable | None, evaluated: Readable, healthy: float) -> float | None:
    """Return the error of a model fitted to a faulty log over that of the healthy log, minus 1.

    Args:
        evaluated: the healthy log in the conventions of the faulty one.
        healthy: error of a model fitted to the healthy log [m].

    Returns:
        None where the healthy log has too few windows, `UNREADABLE` where the faulty log cannot be read.
    """
    return min(error_after(faulty, evaluated) / healthy - 1, UNREADABLE) if np.isfinite(healthy) else None
