"""From a drive to rows at 50 Hz: what every model reads, with nothing guessed and nothing filled."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from offpiste.conventions import ACTUATORS, CONTROL, DT
from offpiste.dataset.cells import Cells
from offpiste.errors import LogError
from offpiste.geometry import local_polynomial
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive, common_span
from offpiste.logs.motion import driven_slope, estimate_motion
from offpiste.logs.poses import find_jumps
from offpiste.rig.rig import ACTUATOR_CHANNELS, CONTROL_CHANNELS, Rig


@dataclass(frozen=True)
class Rows:
    """A drive on an even grid of `conventions.DT` (DESIGN.md, "Files").

    Attributes:
        time: [s], by the pose's clock.
        origin: what was subtracted from px, py [m], so that float32 is fine.
        state, state_causal: targets, and the estimate from the past only (`conventions.STATE`).
        actuators: brake [0..1], steer [rad], steer rate [rad/s], engine [1000 rev/min]; NaN where absent.
        control: throttle [0..1], brake [0..1], steer [-1..1]; NaN where absent.
        normal: surface normals in the world frame, by feature set (D = 1 without a map) and wheel.
        valid: rows where nothing that the log should have is missing.
        cells: the ground cells under the wheels and their features, where a map gave them.
    """

    time: Float[np.ndarray, " N"]
    origin: Float[np.ndarray, " 2"]
    state: Float[np.ndarray, "N 6"]
    state_causal: Float[np.ndarray, "N 6"]
    actuators: Float[np.ndarray, "N 4"]
    control: Float[np.ndarray, "N 3"]
    normal: Float[np.ndarray, "D N 4 3"]
    valid: Bool[np.ndarray, " N"]
    cells: Cells | None = None

    @property
    def distance(self) -> float:
        """Metres driven over the valid rows."""
        return float(np.hypot(*self.state[self.valid, 3:5].T).sum() * DT)


def extract_rows(drive: Drive) -> Rows:
    """Bring a drive to 50 Hz.

    Raises:
        LogError: the channels have no common time, or no second of it is complete.
    """
    start, end = common_span(list(drive.channels.values()), drive.name)
    time = start + DT * np.arange(int((end - start) / DT) + 1)
    motion = estimate_motion(drive, time)
    control = np.column_stack([_column(drive, name, time) for name in CONTROL_CHANNELS])
    actuators = np.column_stack([_column(drive, name, time) for name in ACTUATOR_CHANNELS])
    slope = _slope(drive, time, motion.state)

    given = np.isfinite(motion.state).all(axis=1) & np.isfinite(motion.state_causal).all(axis=1)
    given &= np.isfinite(control[:, [name in present_control(drive.rig) for name in CONTROL]]).all(axis=1)
    given &= np.isfinite(actuators[:, [name in present_actuators(drive.rig) for name in ACTUATORS]]).all(axis=1)
    given &= np.isfinite(slope)
    given &= ~_across_jumps(drive, time)
    if given.sum() * DT < 1.0:
        raise LogError(
            f"no second of it has all channels of the rig ({given.sum()} complete rows of {len(given)})",
            where=drive.name,
            how="run `offpiste inspect` on it; widen clock.max_gap or motion.window, or declare a channel absent",
        )
    origin = motion.state[np.flatnonzero(given)[0], :2].copy()
    shift = np.concatenate((origin, np.zeros(4)))
    return Rows(
        time=time,
        origin=origin,
        state=(motion.state - shift).astype(np.float32),
        state_causal=(motion.state_causal - shift).astype(np.float32),
        actuators=actuators.astype(np.float32),
        control=control.astype(np.float32),
        normal=_normals(slope, motion.state[:, 2]).astype(np.float32),
        valid=given,
    )


def _across_jumps(drive: Drive, time: Float[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Rows whose motion would be estimated from samples on both sides of a jump."""
    across, window = np.zeros(len(time), bool), max(drive.rig.motion.window, 2 * DT)
    for before, after in find_jumps(drive.channels["position"], drive.channels.get("orientation")):
        # Targets look half a window to either side, causal states a whole one back.
        across |= (time > before - window / 2) & (time < after + window)
    return across


def present_control(rig: Rig) -> tuple[str, ...]:
    """Names of `conventions.CONTROL` that a rig's logs have."""
    return tuple(name for name, channel in zip(CONTROL, CONTROL_CHANNELS, strict=True) if channel in rig.channels)


def present_actuators(rig: Rig) -> tuple[str, ...]:
    """Names of `conventions.ACTUATORS` that a rig's logs have; a steering rate can be derived from the angle."""
    have = set(rig.channels) | ({"steer_rate"} if "steer_angle" in rig.channels else set())
    return tuple(name for name, channel in zip(ACTUATORS, ACTUATOR_CHANNELS, strict=True) if channel in have)


def _column(drive: Drive, name: str, time: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """A control or actuator on the grid; NaN where the log does not tell, everywhere if absent."""
    gap = drive.rig.clock.max_gap
    channel = drive.channels.get(name)
    if channel is None and name == "steer_rate" and "steer_angle" in drive.channels:
        channel = _derivative(drive.channels["steer_angle"], window=drive.rig.motion.window)
    if channel is None:
        return np.full(len(time), np.nan)
    source = drive.rig.channels.get(name)
    hold = source is not None and source.interpolation == "hold"
    return (channel.hold if hold else channel.linear)(time, max_gap=gap)[:, 0]


def _derivative(channel: Channel, *, window: float) -> Channel:
    _, rate = local_polynomial(channel.time, channel.values, channel.time, window=window, causal=False)
    known = np.isfinite(rate[:, 0])
    if known.sum() < 2:
        raise LogError(f"{channel.name}: too few samples in {window:g} s for its rate", how="widen motion.window")
    return Channel(f"{channel.name} rate", f"{channel.unit}/s", channel.time[known], rate[known])


def _slope(drive: Drive, time: Float[np.ndarray, " N"], state: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, " N"]:
    """Slope of the driven path, or flat ground where the rig or the log has no elevation."""
    place = drive.channels["position"]
    if drive.rig.motion.normals == "flat" or place.values.shape[1] < 3:
        return np.zeros(len(time))
    position = place.linear(time, max_gap=drive.rig.clock.max_gap)
    speed = np.copysign(np.hypot(state[:, 3], state[:, 4]), state[:, 3])
    return driven_slope(position, speed, dt=DT, length=drive.rig.motion.slope_length)


def _normals(slope: Float[np.ndarray, " N"], yaw: Float[np.ndarray, " N"]) -> Float[np.ndarray, "1 N 4 3"]:
    """The normal of a plane that rises by `slope` along the heading; the same under all wheels."""
    normal = np.stack((-slope * np.cos(yaw), -slope * np.sin(yaw), np.ones_like(slope)), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.repeat(normal[None, :, None], 4, axis=2)
