"""Driven path from the pose alone, the reference for all other channels."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.geometry import local_polynomial, planar_body_from_world, rotation_from_quaternion
from offpiste.inspection.lags import fit_lags
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive, common_span
from offpiste.logs.motion import across_jumps, driven_slope, heading

STEP = 0.05
"""Time between rows [s]."""
_WINDOW = 0.4
"""Time span of the pose samples used for a velocity [s]; slow poses use six samples."""
MOVING = 0.3
"""Speed below which the vehicle is at a standstill [m/s]."""
DELAYS = np.arange(-30, 31) * STEP
"""Candidate delays of a recorded motion [s]."""
TURNING = 0.05
"""Minimum standard deviation of the yaw rate in a drive with turning [rad/s]."""


@dataclass(frozen=True)
class DrivenPath:
    """Motion on a uniform time grid, from the pose, without delay; NaN in gaps.

    Attributes:
        time: [s].
        place: horizontal position [m].
        velocity: horizontal world velocity [m/s].
        speed: norm of `velocity` [m/s].
        forward: velocity along the heading [m/s].
        yaw, yaw_rate: heading and its rate [rad, rad/s].
        acceleration: d(forward)/dt [m/s^2].
        slope: dz/ds of the path, s along the motion, also in reverse; 0 for planar positions.
        reverse: True if the log's gear is reverse; None without a gear.
        window: time span of the pose samples used for each velocity [s].
    """

    time: Float[np.ndarray, " n"]
    place: Float[np.ndarray, "n 2"]
    velocity: Float[np.ndarray, "n 2"]
    speed: Float[np.ndarray, " n"]
    forward: Float[np.ndarray, " n"]
    yaw: Float[np.ndarray, " n"]
    yaw_rate: Float[np.ndarray, " n"]
    acceleration: Float[np.ndarray, " n"]
    slope: Float[np.ndarray, " n"]
    window: float = _WINDOW
    reverse: Bool[np.ndarray, " n"] | None = None

    @property
    def distance(self) -> float:
        """Return the length of the path [m], without standstills."""
        return float(np.nansum(np.where(self.speed > self.slowest, self.speed, 0.0)) * STEP)

    @property
    def driving(self) -> float:
        """Return the time in motion [s]."""
        return float(np.sum(np.nan_to_num(self.speed) > MOVING) * STEP)

    @property
    def slowest(self) -> float:
        """Return the standstill speed of this vehicle [m/s]: below `MOVING` for slow drives."""
        return min(MOVING, 0.1 * self.cruise)

    @property
    def cruise(self) -> float:
        """Return the 95th percentile of the speed [m/s], the characteristic speed of this vehicle."""
        return float(np.nanpercentile(self.speed, 95)) if np.isfinite(self.speed).any() else 0.0

    def longer_side(self, at: float) -> "DrivenPath":
        """Return the part before or after a time [s], whichever is longer."""
        row = int(np.searchsorted(self.time, at))
        rows = slice(0, row) if row > len(self.time) - row else slice(row, None)
        columns: dict[str, Any] = {k: v[rows] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **columns)


def driven_path(drive: Drive) -> DrivenPath:
    """Compute the motion from positions and headings, without recorded velocities.

    Raises:
        LogError: positions and headings do not overlap in time, or overlap for longer than one drive.
    """
    place, yaw = drive.channels["position"], heading(drive)
    start, end = common_span([place, yaw], drive.name)
    time = np.arange(start, end, STEP)
    window = max(_WINDOW, *(6 * float(np.median(np.diff(channel.time))) for channel in (place, yaw)))

    position, velocity = local_polynomial(place.time, place.values - place.values[0], time, window=window, causal=False)
    turned, yaw_rate = local_polynomial(yaw.time, yaw.values, time, window=window, causal=False)
    forward = planar_body_from_world(velocity[:, :2], turned[:, 0])[:, 0]
    known = np.isfinite(forward)
    acceleration = np.full(len(time), np.nan)
    if known.sum() > 10:
        acceleration[known] = local_polynomial(
            time[known], forward[known, None], time[known], window=max(0.6, window), causal=False
        )[1][:, 0]

    speed = np.hypot(*velocity[:, :2].T)
    stretches = np.where(across_jumps(drive, time)[:, None], np.nan, position)
    slope = (
        driven_slope(stretches, speed, dt=STEP, length=drive.rig.motion.slope_length)
        if position.shape[1] == 3
        else np.zeros(len(time))
    )
    return DrivenPath(
        time,
        position[:, :2],
        velocity[:, :2],
        speed,
        forward,
        turned[:, 0],
        yaw_rate[:, 0],
        acceleration,
        slope,
        window,
        _reverse(drive, time),
    )


def heading_name(drive: Drive) -> str:
    """Return the name of the channel that holds the heading."""
    return "yaw" if "yaw" in drive.channels else "orientation"


def on_path(path: DrivenPath, recorded: Channel) -> Float[np.ndarray, "n k"]:
    """Return a channel at the path's times with the path's smoothing; NaN outside of the record and in gaps."""
    window = max(path.window, 4 * float(np.median(np.diff(recorded.time))))
    return local_polynomial(recorded.time, recorded.values, path.time, window=window, causal=False)[0]


def levelled(drive: Drive, path: DrivenPath, recorded: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n 2"]:
    """Return the horizontal part of a body-frame velocity, with pitch and roll removed (rotated by minus yaw)."""
    if recorded.shape[1] == 2 or "orientation" not in drive.channels:
        return recorded[:, :2]
    orientation = drive.channels["orientation"].linear(path.time, max_gap=np.inf)
    world = np.einsum("nij,nj->ni", rotation_from_quaternion(np.nan_to_num(orientation, nan=0.5)), recorded)
    return planar_body_from_world(world[:, :2], path.yaw)


def _reverse(drive: Drive, time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"] | None:
    if "gear" not in drive.channels:
        return None
    return np.asarray(drive.channels["gear"].hold(time, max_gap=np.inf)[:, 0] < 0)


@dataclass(frozen=True)
class FrameFit:
    """Fit of a velocity to the pose's derivative in one frame.

    Attributes:
        misfit: RMS difference over the RMS speed, after removal of the best gain and delay.
        gain, gain_sigma: ratio of recorded to true, and its standard deviation.
        delay, delay_sigma: delay of the recorded velocity, and its standard deviation [s].
    """

    frame: str
    misfit: float
    gain: float
    gain_sigma: float
    delay: float
    delay_sigma: float


def fit_delayed(frame: str, recorded: Float[np.ndarray, "n c"], true: Float[np.ndarray, "n c"]) -> FrameFit | None:
    """Fit `recorded(t) = gain * true(t - delay)`; return None with too few data or too little motion."""
    count, parts = true.shape
    shifted = np.full((len(DELAYS), parts, count), np.nan)
    for lag, row in zip(np.rint(DELAYS / STEP).astype(int), shifted, strict=True):
        row[:, max(lag, 0) : count + min(lag, 0)] = true.T[:, max(-lag, 0) : count - max(lag, 0)]
    everywhere = np.ones(recorded.size, bool)
    flat = shifted.reshape(len(DELAYS), -1)
    fit = fit_lags(recorded.T.ravel(), np.zeros((recorded.size, 0)), flat, DELAYS, everywhere)
    if fit is None:
        return None
    best = fit.best()
    delay, delay_sigma = fit.delay(best)
    misfit = float(np.sqrt(max(1 - fit.r[best] ** 2, 0.0)))
    return FrameFit(frame, misfit, float(fit.gain[best]), fit.gain_sigma(best), delay, delay_sigma)
