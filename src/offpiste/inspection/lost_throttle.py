"""Check for a throttle that reads zero while the vehicle is driven, as after a lost connection."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath
from offpiste.inspection.findings import Finding, of_runs
from offpiste.inspection.lags import LAGS, LagFit, sampled
from offpiste.inspection.pedals import OWN_DELAY, RELEASED, pedal_base
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive

_LEAST: Final = 0.5
"""Minimum duration of a run of zeros [s]; an acceleration uses 0.6 s of samples."""
_SETTLED: Final = 0.3
"""Response time of the vehicle [s], excluded at both ends of a run."""
_ROWS: Final = 200
"""Minimum number of rows outside a run for a fit: 10 s of driving."""
_STRETCH: Final = 5.0
"""Maximum duration of the reference stretches [s]; longer ones are rare in a drive."""
_SURE, _SURE_ALONE = 3.5, 5.0
"""Minimum residual acceleration in standard deviations of equally long stretches, with and without a throttle step at
an end of the run."""
_LEAP: Final = 0.3
"""Minimum step into or out of the run, as a share of the throttle that explains the motion."""
_PRESSED: Final = 0.3
"""Minimum explained throttle as a share of the driver's usual one ..."""
_FULL: Final = 1.5
"""... and its maximum; more than full throttle has another cause: a hill, a push, a gear change."""
_CRUISE: Final = 0.2
"""Share of the cruising speed below which starting jerks and gear changes dominate the throttle's effect."""


def check_lost_throttle(fit: LagFit, drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if the vehicle accelerates during zeros of the throttle as if it were pressed.

    The acceleration is fitted without each run of zeros; the residual within the run, divided by the gain of full
    throttle, is the actual throttle.

    Args:
        fit: of the throttle, from `pedals.pedal_fits`.
    """
    push = _push(fit, drive, path)
    runs = [run for run in _runs(drive.channels["throttle"]) if _is_lost(run, push, drive, path)]
    if not runs:
        return []
    begin, lasts = np.array([(begin, end - begin) for begin, end in runs]).T
    longest = int(lasts.argmax())
    start = begin[longest] - drive.channels["throttle"].time[0]
    run = f"for {lasts[longest]:.1f} s from {start:.2f} s on, where the acceleration is that of "
    run += f"{_pressed(*runs[longest], push, path)[0]:.2f} of full throttle"
    return [of_runs("throttle", "is zero while the vehicle is driven on", lasts, run, path.driving)]


def _runs(channel: Channel) -> list[tuple[float, float]]:
    """Return the first and last times of sufficiently long runs of zeros."""
    zero = np.concatenate(([False], channel.values[:, 0] == 0, [False]))
    first, after = np.flatnonzero(np.diff(zero.astype(int))).reshape(-1, 2).T
    begin, end = channel.time[first], channel.time[after - 1]
    long = end - begin >= _LEAST
    return list(zip(begin[long], end[long], strict=True))


@dataclass(frozen=True)
class _Push:
    """Regression data of the acceleration, shared by all runs.

    Attributes:
        lag: of the acceleration behind the throttle [s].
        throttle: at the path's times minus this lag.
        columns: regressors; the throttle is the last.
        gained: acceleration along the motion [m/s^2].
        known: rows in which all of these are known.
        braked: rows in which the brake acts.
        normal, target: normal equations over the known rows.
    """

    lag: float
    throttle: Float[np.ndarray, " n"]
    columns: Float[np.ndarray, "n b"]
    gained: Float[np.ndarray, " n"]
    known: Bool[np.ndarray, " n"]
    braked: Bool[np.ndarray, " n"]
    normal: Float[np.ndarray, "b b"]
    target: Float[np.ndarray, " b"]

    def without(self, rows: slice) -> Float[np.ndarray, " b"]:
        """Solve least squares over the known rows except these, by sums, as a long drive has hundreds of runs."""
        left_out = self.columns[rows][self.known[rows]]
        normal = self.normal - left_out.T @ left_out
        target = self.target - left_out.T @ self.gained[rows][self.known[rows]]
        return np.asarray(np.linalg.lstsq(normal, target, rcond=None)[0])


def _push(fit: LagFit, drive: Drive, path: DrivenPath) -> _Push:
    lag = float(LAGS[fit.best(*OWN_DELAY["throttle"], sign=1)])
    throttle = sampled(drive.channels["throttle"], path.time - lag, drive.rig)
    columns = np.column_stack((pedal_base(path, drive.channels.get("brake"), drive.rig), throttle))
    gained = path.acceleration * np.sign(path.forward)
    known = (path.speed > MOVING) & np.isfinite(gained) & np.isfinite(columns).all(axis=1)
    rows = columns[known]
    braked = _braked(drive, path)
    return _Push(lag, throttle, columns, gained, known, braked, rows.T @ rows, rows.T @ gained[known])


def _is_lost(run: tuple[float, float], push: _Push, drive: Drive, path: DrivenPath) -> bool:
    pressed, sigmas, usual = _pressed(*run, push, path)
    if sigmas < _SURE or not _PRESSED * usual < pressed < _FULL:
        return False
    channel = drive.channels["throttle"]
    first, last = np.searchsorted(channel.time, run)
    beside = channel.values[[max(first - 1, 0), min(last + 1, len(channel.values) - 1)], 0]
    return bool(sigmas > _SURE_ALONE or beside.max() > _LEAP * pressed)


def _pressed(begin: float, end: float, push: _Push, path: DrivenPath) -> tuple[float, float, float]:
    """Return the throttle that explains the motion within a run, its significance in sigmas, and the usual throttle.

    Returns:
        Zeros with too few data.
    """
    near = slice(int(np.searchsorted(path.time, begin)), int(np.searchsorted(path.time, end + 1.0, side="right")))
    others = push.known.copy()
    others[near] = False
    within = push.known & ~push.braked & (path.time > begin + push.lag + _SETTLED)
    within &= path.time < end + push.lag - min(_SETTLED, (end - begin) / 3)
    if others.sum() < _ROWS or not _driven(within, path) or not (push.throttle[others] > 0).any():
        return 0.0, 0.0, 0.0
    solution = push.without(near)
    if solution[-1] <= 0:
        return 0.0, 0.0, 0.0
    missed = push.gained - push.columns @ solution
    stretches = _means(missed[others], min(int(within.sum()), round(_STRETCH / STEP)))
    more = float(missed[within].mean())
    usual = float(np.median(push.throttle[others & (push.throttle > 0)]))
    return more / float(solution[-1]), more / float(np.sqrt(np.mean(stretches**2))), usual


def _braked(drive: Drive, path: DrivenPath) -> Bool[np.ndarray, " n"]:
    """Return rows with the brake pressed now or just before; its effect may be reduced on slippery ground."""
    brake = drive.channels.get("brake")
    if brake is None:
        return np.zeros(len(path.time), bool)
    pressed = [sampled(brake, path.time - late, drive.rig) > RELEASED for late in (0.0, _SETTLED)]
    return np.asarray(pressed[0] | pressed[1])


def _driven(within: Bool[np.ndarray, " n"], path: DrivenPath) -> bool:
    """Return whether a run has at least 4 rows and its mean speed exceeds the driving threshold.

    The threshold is 2 `MOVING`, or the share `_CRUISE` of the cruising speed if that is higher.
    """
    return bool(within.sum() >= 4 and path.speed[within].mean() > max(2 * MOVING, _CRUISE * path.cruise))


def _means(values: Float[np.ndarray, " n"], count: int) -> Float[np.ndarray, " m"]:
    """Return the means of consecutive stretches of `count` values."""
    whole = len(values) // count * count
    return np.asarray(values[:whole].reshape(-1, count).mean(axis=1))
