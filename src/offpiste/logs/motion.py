"""Planar motion on a time grid: smoothed with zero phase for targets, and causal for initial states."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.conventions import DT
from offpiste.core.geometry import (
    local_polynomial,
    planar_body_from_world,
    rotation_from_quaternion,
    yaw_from_quaternion,
    yaw_rate_from_body_rates,
)
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive

_MOVING = 0.2
"""Speed below which the vehicle stands still [m/s]: noise does not add to the path."""
_SPACING = 0.1
"""Length of path per elevation sample [m]."""
_STALE = 0.1
"""Largest age of the headings that rotate velocities [s]."""


@dataclass(frozen=True)
class Motion:
    """Planar states at N times (`offpiste.core.conventions.STATE`); NaN where unknown."""

    state: Float[np.ndarray, "N 6"]  # targets; velocities derived from the pose are smoothed with zero phase
    # From samples stamped at or before each time; NaN if one of these was dropped as implausible (`pose_faults`).
    state_causal: Float[np.ndarray, "N 6"]


def estimate_motion(drive: Drive, at: Float[np.ndarray, " N"]) -> Motion:
    """Estimate the planar states of a drive at given times [s].

    Logged velocities are used if the rig gives their frame; otherwise local polynomials through the pose give position,
    heading and their rates together.
    """
    return Motion(_states(drive, at, causal=False), _states(drive, at, causal=True))


def heading(drive: Drive) -> Channel:
    """Return the yaw at its native stamps, unwrapped [rad]."""
    if "yaw" in drive.channels:
        channel = drive.channels["yaw"]
        yaw = np.unwrap(channel.values[:, 0])
    else:
        channel = drive.channels["orientation"]
        yaw = yaw_from_quaternion(channel.values)
    return Channel("yaw", "rad", channel.time, yaw[:, None])


def across_jumps(drive: Drive, at: Float[np.ndarray, " N"], *, causal: bool = False) -> Bool[np.ndarray, " N"]:
    """Mark times whose motion is estimated from samples on both sides of a jump of the pose.

    Args:
        causal: for `Motion.state_causal` only, which later jumps do not change.
    """
    (before, after), window = drive.faults.breaks().T, max(drive.rig.motion.window, 2 * DT)
    # Targets use half a window to either side, causal states a whole one back.
    begin, side = (after, "right") if causal else (before - window / 2, "left")
    begun = np.searchsorted(np.sort(begin), at, side=side)  # type: ignore[call-overload]
    return np.asarray(begun > np.searchsorted(np.sort(after + window), at, side="right"))


def driven_slope(
    position: Float[np.ndarray, "N 3"],
    speed: Float[np.ndarray, " N"],
    *,
    dt: float,
    length: float,
    causal: bool = False,
) -> Float[np.ndarray, " N"]:
    """Return the slope of the driven path, dz/ds, in place of the ground's slope for logs without a map.

    It is fitted over distance rather than time, which would let the pitching of the body under braking through.

    Args:
        position: smoothed positions, z up [m]; rows with NaN give NaN, and no fit spans them.
        speed: horizontal speed, negative in reverse [m/s].
        dt: time step of the rows [s].
        length: length of the path behind one estimate [m].
        causal: fit only rows at or before each row; the last slope is kept until enough path was driven after a
            reversal.
    """
    known = np.isfinite(position).all(axis=1) & np.isfinite(speed)
    slope = np.full(len(position), np.nan)
    rows = np.flatnonzero(known)
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if len(run):
            step = np.where(np.abs(speed[run]) > _MOVING, speed[run], 0.0) * dt
            fit = _slope_behind if causal else _slope_along
            slope[run] = fit(step, position[run, 2], length=length)
    return slope


def _slope_along(
    step: Float[np.ndarray, " N"], elevation: Float[np.ndarray, " N"], *, length: float
) -> Float[np.ndarray, " N"]:
    """Return the slope of a continuous path; 0 if it is too short."""
    distance = np.cumsum(step)
    distance = distance - distance.min()
    # A vehicle at rest must not outweigh the path before and after it.
    cell, of = np.unique(np.round(distance / _SPACING), return_inverse=True)
    mean = np.bincount(of, weights=elevation) / np.bincount(of)
    along = cell * _SPACING
    _, fitted = local_polynomial(along, mean[:, None], along, window=length, causal=False)
    fitted = fitted[:, 0]
    usable = np.isfinite(fitted)
    return np.interp(distance, along[usable], fitted[usable]) if usable.any() else np.zeros(len(distance))


def _slope_behind(
    step: Float[np.ndarray, " N"], elevation: Float[np.ndarray, " N"], *, length: float
) -> Float[np.ndarray, " N"]:
    """Return the slope of a continuous path from the rows up to each row; 0 until enough was driven."""
    travelled, row = np.cumsum(np.abs(step)), np.arange(len(step))
    moving = np.maximum.accumulate(np.where(step != 0, row, 0))
    direction = np.sign(step[moving])
    slope = np.full(len(step), np.nan)
    for leg in np.split(row, np.flatnonzero(np.diff(direction)) + 1):
        cell = np.floor(travelled[leg] / _SPACING)
        entered = np.flatnonzero(np.diff(cell, prepend=-1.0))
        along = travelled[leg[entered]]
        _, fitted = local_polynomial(along, elevation[leg[entered], None], along, window=length, causal=True)
        slope[leg[entered]] = direction[leg[entered]] * fitted[:, 0]
    latest = np.maximum.accumulate(np.where(np.isfinite(slope), row, -1))
    return np.where(latest >= 0, slope[latest], 0.0)


def _states(drive: Drive, at: Float[np.ndarray, " N"], *, causal: bool) -> Float[np.ndarray, "N 6"]:
    gap, window = drive.rig.clock.max_gap, drive.rig.motion.window
    place, yaw = drive.channels["position"], heading(drive)
    velocity, rate = _own_velocity(drive, causal=causal), _own_yaw_rate(drive, causal=causal)

    def sampled(value: Channel, rate: Channel | None = None) -> np.ndarray:
        """Interpolate a channel; if causal, return its last sample, extrapolated by its rate."""
        if not causal:
            return value.linear(at, max_gap=gap)
        last = value.latest(at, max_gap=gap)
        if rate is None:
            return last
        age = at - value.time[np.maximum(np.searchsorted(value.time, at, side="right") - 1, 0)]
        return extrapolated(last[:, : rate.values.shape[1]], rate.latest(at, max_gap=gap), age)

    covered = np.isfinite(sampled(place)[:, 0] + sampled(yaw)[:, 0])
    if causal:
        covered &= ~drive.faults.touched(at, window + _STALE)
    if velocity is not None:
        xy, v_world = sampled(place, velocity)[:, :2], sampled(velocity)
    else:
        xy, v_world = local_polynomial(place.time, place.values[:, :2], at, window=window, causal=causal)
    if rate is not None:
        psi, psi_rate = sampled(yaw, rate), sampled(rate)
    else:
        psi, psi_rate = local_polynomial(yaw.time, yaw.values, at, window=window, causal=causal)
    return np.where(covered[:, None], planar_state(xy, psi, v_world, psi_rate), np.nan)


def extrapolated(
    value: Float[np.ndarray, "N k"], rate: Float[np.ndarray, "N k"], age: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "N k"]:
    """Extrapolate the last samples, `age` [s] old, by the last rates."""
    return value + age[:, None] * rate


def planar_state(
    xy: Float[np.ndarray, "N 2"],
    yaw: Float[np.ndarray, "N 1"],
    velocity: Float[np.ndarray, "N 2"],
    yaw_rate: Float[np.ndarray, "N 1"],
) -> Float[np.ndarray, "N 6"]:
    """Return states (`offpiste.core.conventions.STATE`) from positions [m] and world velocities [m/s]."""
    return np.concatenate((xy, yaw, planar_body_from_world(velocity, yaw[:, 0]), yaw_rate), axis=1)


def _at_stamps(channel: Channel, of: Channel, *, causal: bool) -> Float[np.ndarray, "n k"]:
    """Return a channel at another's stamps: interpolated, or the last sample if `causal`."""
    return (channel.latest if causal else channel.linear)(of.time, max_gap=np.inf)


def _own_velocity(drive: Drive, *, causal: bool) -> Channel | None:
    """Return the logged horizontal velocity in the world frame [m/s]; None if the rig does not give its frame."""
    channel = drive.channels.get("linear_velocity")
    if channel is None:
        return None
    frame = drive.rig.channels["linear_velocity"].frame
    if frame == "unknown":
        return None
    if frame == "world":
        return Channel("velocity", channel.unit, channel.time, channel.values[:, :2])
    if "orientation" in drive.channels and channel.values.shape[1] == 3:
        orientation = _at_stamps(drive.channels["orientation"], channel, causal=causal)
        world = np.einsum("Nij,Nj->Ni", rotation_from_quaternion(np.nan_to_num(orientation, nan=0.5)), channel.values)
        known = np.isfinite(orientation).all(axis=1)
    else:
        yaw = _at_stamps(heading(drive), channel, causal=causal)[:, 0]
        world, known = planar_body_from_world(channel.values[:, :2], -yaw), np.isfinite(yaw)
    return Channel("velocity", channel.unit, channel.time[known], world[known, :2])


def _own_yaw_rate(drive: Drive, *, causal: bool) -> Channel | None:
    """Return the logged d(yaw)/dt [rad/s]; None if there is none."""
    if "yaw_rate" in drive.channels:
        return drive.channels["yaw_rate"]
    gyro = drive.channels.get("angular_velocity")
    if gyro is None or drive.rig.channels["angular_velocity"].frame != "body" or "orientation" not in drive.channels:
        return None
    orientation = _at_stamps(drive.channels["orientation"], gyro, causal=causal)
    known = np.isfinite(orientation).all(axis=1)
    rate = yaw_rate_from_body_rates(orientation[known], gyro.values[known])
    return Channel("yaw_rate", gyro.unit, gyro.time[known], rate[:, None])
