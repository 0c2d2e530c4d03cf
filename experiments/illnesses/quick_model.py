"""A quick model of planar motion, to see what an illness costs: a bicycle with understeer, and pedals behind a lag.

Eight constants, fitted by least squares on windows of five seconds; about a second a log. It knows no terrain: what
counts is how much worse it gets, not how good it is.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from offpiste.core.conventions import DT, HORIZON_STEPS
from offpiste.dataset.resample import Rows
from offpiste.rig.rig import Vehicle

_EVERY: Final = 5
"""Rows of one step of the model: 0.1 s."""
_STEPS: Final = HORIZON_STEPS // _EVERY
_MOST_WINDOWS: Final = 60
_LEAST_WINDOWS: Final = 4
_DIFFERENCE: Final = 1e-6
"""Step of the differences that stand for derivatives."""
_START: Final = np.array((1.0, 0.05, 0.0, 0.2, 1.0, 1.0, 0.05, 0.2))
"""Steering's gain, understeer, its centre, lag of the turning; pedals' accelerations, drag, rolling resistance.

Lengths and times are in units of the wheelbase and of its Froude time, so that one start fits all sizes."""


@dataclass(frozen=True)
class QuickModel:
    """A fitted model.

    Attributes:
        constants: in the order of `_START`.
    """

    constants: Float[np.ndarray, " 8"]


@dataclass(frozen=True)
class Windows:
    """Windows of W starts and `_STEPS` steps.

    Attributes:
        start: x, y, yaw, vx, vy, yaw_rate [m, rad, m/s, rad/s].
        throttle, brake, angle: held over each step; the angle of the road wheels [rad].
        place: x, y after each step [m].
    """

    start: Float[np.ndarray, "W 6"]
    throttle: Float[np.ndarray, "S W"]
    brake: Float[np.ndarray, "S W"]
    angle: Float[np.ndarray, "S W"]
    place: Float[np.ndarray, "S W 2"]


def windows_of(rows: Rows, vehicle: Vehicle, *, first: float, last: float, most: int = _MOST_WINDOWS) -> Windows | None:
    """Evenly chosen windows in which all rows are valid and the vehicle moves.

    Args:
        first, last: time that the windows lie in [s].
        most: number of windows.

    Returns:
        None where there are too few.
    """
    inside = rows.valid & (rows.time >= first) & (rows.time <= last)
    broken = np.concatenate(([0], np.cumsum(~inside)))
    starts = np.arange(0, len(rows.time) - HORIZON_STEPS - 1, _EVERY)
    whole = broken[starts + HORIZON_STEPS + 1] == broken[starts]
    fast = np.hypot(*rows.state[starts, 3:5].T) > 0.3 * np.sqrt(vehicle.wheelbase)
    starts = starts[whole & fast]
    if len(starts) < _LEAST_WINDOWS:
        return None
    starts = starts[np.unique(np.linspace(0, len(starts) - 1, most).astype(int))]
    return _windows_at(rows, starts, vehicle)


def _windows_at(rows: Rows, starts: Int[np.ndarray, " W"], vehicle: Vehicle) -> Windows:
    # A step's command is the mean over its rows: less would alias short pulses.
    within = starts[None, :, None] + _EVERY * np.arange(_STEPS)[:, None, None] + np.arange(_EVERY)
    control = np.nan_to_num(rows.control[within].mean(axis=2).astype(np.float64))
    after = starts[None] + _EVERY * np.arange(1, _STEPS + 1)[:, None]
    return Windows(
        start=rows.state[starts].astype(np.float64),
        throttle=control[..., 0],
        brake=control[..., 1],
        angle=vehicle.max_steer * control[..., 2],
        place=rows.state[after][..., :2].astype(np.float64),
    )


def rolled_out(
    constants: Float[np.ndarray, "... 8"], windows: Windows, wheelbase: float
) -> Float[np.ndarray, "S ... W 2"]:
    """Places after each step [m], for one set of constants or several at once.

    Args:
        wheelbase: [m].
    """
    gain, understeer, centre, lag, pull, stop, drag, rolling = (constants[..., i, None] for i in range(8))
    unit = np.sqrt(wheelbase / 9.81)
    dt = DT * _EVERY
    shape = (*constants.shape[:-1], len(windows.start))
    x, y, yaw, v, side, rate = (np.broadcast_to(column, shape) for column in windows.start.T)
    keep = np.exp(-dt / (unit * np.maximum(np.abs(lag), 1e-2)))
    fade = np.exp(-dt / (2 * unit))
    places = np.empty((_STEPS, *shape, 2))
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(_STEPS):
            curvature = gain * np.tan(np.clip(windows.angle[step] + centre, -1.4, 1.4)) / wheelbase
            lateral = v * v * unit**2 / wheelbase**2
            rate = keep * rate + (1 - keep) * v * curvature / (1 + np.abs(understeer) * lateral)
            motion = np.clip(v / (0.3 * wheelbase / unit), -1, 1)
            force = pull * windows.throttle[step] - (5 * stop * windows.brake[step] + rolling) * motion
            v = np.clip(v + dt * (force - drag * v * unit / wheelbase * 9.81), -1e3, 1e3)
            side = fade * side
            middle = yaw + 0.5 * dt * rate
            x = x + dt * (v * np.cos(middle) - side * np.sin(middle))
            y = y + dt * (v * np.sin(middle) + side * np.cos(middle))
            yaw = yaw + dt * rate
            places[step, ..., 0], places[step, ..., 1] = x, y
    return places


def fit(windows: Windows, wheelbase: float) -> QuickModel:
    """The model that predicts these windows best."""
    scale = _scale(windows, wheelbase)
    some = (np.array((0.2, 0.4, 0.7, 1.0)) * _STEPS).astype(int) - 1

    def residuals(constants: np.ndarray) -> np.ndarray:
        away = np.moveaxis(rolled_out(constants, windows, wheelbase)[some], 1, 0) - windows.place[some]
        left: np.ndarray = np.nan_to_num(away / scale, nan=1e3).reshape(len(constants), -1)
        return np.clip(left, -1e3, 1e3)

    def slopes(constants: np.ndarray) -> np.ndarray:
        # All differences in one rollout: small arrays cost as much as larger ones.
        stepped = residuals(np.vstack((constants, constants + _DIFFERENCE * np.eye(8))))
        return (stepped[1:] - stepped[0]).T / _DIFFERENCE

    fitted = least_squares(lambda c: residuals(c[None])[0], _START, jac=slopes, loss="soft_l1", max_nfev=25)
    return QuickModel(fitted.x)


def error_of(model: QuickModel, windows: Windows, wheelbase: float) -> float:
    """Mean distance between predicted and driven place after five seconds [m]."""
    away = rolled_out(model.constants, windows, wheelbase)[-1] - windows.place[-1]
    return float(np.mean(np.hypot(*away.T)))


def _scale(windows: Windows, wheelbase: float) -> float:
    """Typical distance that is driven in a window, at least a wheelbase [m]."""
    driven = np.hypot(*(windows.place[-1] - windows.start[:, :2]).T)
    return max(0.1 * float(np.median(driven)), 0.1 * wheelbase)
