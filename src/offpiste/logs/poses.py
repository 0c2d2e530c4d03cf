"""Poses of the vehicle at any moment of a log, and the jumps in them, across which no map and no window may reach."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from offpiste.errors import RigError
from offpiste.geometry import rotation_from_quaternion
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive


@dataclass(frozen=True)
class Poses:
    """Poses `world_from_body`, interpolated linearly in position and by slerp in orientation.

    Attributes:
        position: [m].
        orientation: quaternions xyzw.
        max_gap: nothing is interpolated between samples further apart [s].
        jumps: last moment before and first moment after each jump [s]; nothing is interpolated between the two, and a
            map from before does not fit after.
        unknown: last moment before and first moment after runs of implausible samples [s]; nothing is interpolated
            between the two either.
    """

    position: Channel
    orientation: Channel
    max_gap: float
    jumps: Float[np.ndarray, "j 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    unknown: Float[np.ndarray, "u 2"] = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment that is known [s]."""
        p, q = self.position.time, self.orientation.time
        return float(max(p[0], q[0])), float(min(p[-1], q[-1]))

    def at(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """`world_from_body` at any moments [s]; NaN where unknown: outside of the log, across gaps and jumps."""
        matrix = np.zeros((len(time), 4, 4))
        matrix[:, :3, 3] = self.position.linear(time, max_gap=self.max_gap)
        matrix[:, :3, :3] = rotation_from_quaternion(slerp(self.orientation, time, max_gap=self.max_gap))
        matrix[:, 3, 3] = 1.0
        for before, after in (*self.jumps, *self.unknown):
            matrix[(time > before) & (time < after)] = np.nan
        matrix[~np.isfinite(matrix).all(axis=(1, 2))] = np.nan
        return matrix

    def known(self, time: float) -> float:
        """When the pose at a moment was known [s]: the stamp of the sample after it; infinite at the end of the log."""
        stamps = (channel.time for channel in (self.position, self.orientation))
        return float(max(np.append(t, np.inf)[np.searchsorted(t, time, side="right")] for t in stamps))

    def stretch(self, time: float) -> int:
        """Number of jumps until a moment [s]: positions of one stretch fit together."""
        return int(np.searchsorted(self.jumps[:, 1], time, side="right"))


def poses_from_drive(drive: Drive) -> Poses:
    """The poses of a drive.

    Raises:
        RigError: without height or full orientation, LiDAR points cannot be put into the world.
    """
    position, orientation = drive.channels.get("position"), drive.channels.get("orientation")
    if orientation is None or position is None or position.values.shape[1] != 3:
        raise RigError(
            f"{drive.name}: cameras and LiDARs need positions with z, and orientations as quaternions",
            how="give channels.position three fields, and channels.orientation",
        )
    jumps = find_jumps(position, orientation)
    return Poses(position, orientation, drive.rig.clock.max_gap, jumps, drive.faults.unknown())


def slerp(orientation: Channel, at: Float[np.ndarray, " n"], *, max_gap: float) -> Float[np.ndarray, "n 4"]:
    """Quaternions between samples (Shoemake, SIGGRAPH 1985); NaN outside of the record and across gaps."""
    # SciPy's Slerp gives the same to 6e-16, but takes 2.5 ms instead of 0.5 ms for the 2000 moments of a scan, and
    # 10 ms more to build on 6000 samples.
    time, q = orientation.time, orientation.values
    after = np.clip(np.searchsorted(time, at, side="right"), 1, len(time) - 1)
    begin, end = q[after - 1], q[after]
    share = np.clip((at - time[after - 1]) / (time[after] - time[after - 1]), 0, 1)[:, None]
    cosine = np.einsum("ni,ni->n", begin, end)[:, None] / np.linalg.norm(begin, axis=1, keepdims=True)
    cosine /= np.linalg.norm(end, axis=1, keepdims=True)
    end = np.where(cosine < 0, -end, end)  # q and -q turn alike; the short way round is meant
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    sine = np.sin(angle)
    near = sine < 1e-6
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.sin((1 - share) * angle) / sine, np.sin(share * angle) / sine
    mixed = np.where(near, 1 - share, weights[0]) * begin + np.where(near, share, weights[1]) * end
    mixed[~orientation.covered(at, max_gap)] = np.nan
    return mixed


FARTHEST: Final = 1.0
"""Least excess of a step, over what the speed explains, that is a jump [m]: five cells of the map. GPS has many shorter
ones, which `offpiste inspect` lists."""
_UNTIL: Final = 11
"""Number of steps, the last of which is the step itself, whose median speed explains it: never later ones."""
_ACCELERATION: Final = 10.0
"""Largest change of speed [m/s^2]; counts where samples are far apart."""
_TURN: Final = np.deg2rad(20.0)
"""Least turn between two samples that is a jump [rad] ..."""
_TURN_RATE: Final = 4.0
"""... if it is also faster than this [rad/s], which no vehicle turns."""


def find_jumps(position: Channel, orientation: Channel | None = None) -> Float[np.ndarray, "j 2"]:
    """Last moment before and first moment after each jump, in the order of time [s]."""
    result = [_between(position, position_excess(position) > FARTHEST)]
    if orientation is not None and len(orientation.time) > 1:
        turned = _turns(orientation)
        limit = np.maximum(_TURN, _TURN_RATE * np.diff(orientation.time))
        result.append(_between(orientation, turned > limit))
    jumps = np.concatenate(result)
    return jumps[np.lexsort(jumps.T[::-1])]


def position_excess(position: Channel) -> Float[np.ndarray, " m"]:
    """Excess of each of the m = n - 1 steps over what the speed until then explains [m]."""
    step = np.linalg.norm(np.diff(position.values, axis=0), axis=1)
    dt = np.diff(position.time)
    speed = median_filter(step / dt, _UNTIL, mode="nearest", origin=_UNTIL // 2)
    return step - (speed + _ACCELERATION * dt) * dt


def _turns(orientation: Channel) -> Float[np.ndarray, " m"]:
    """Angles between neighbouring samples [rad]."""
    matrix = rotation_from_quaternion(orientation.values)
    trace = np.einsum("nij,nij->n", matrix[:-1], matrix[1:])
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def _between(channel: Channel, jumps: np.ndarray) -> Float[np.ndarray, "j 2"]:
    first = np.flatnonzero(jumps)
    return np.stack((channel.time[first], channel.time[first + 1]), axis=1)


def jump_note(poses: Poses) -> list[str]:
    """Times of the jumps in words; nothing where there are none."""
    jumps = poses.jumps
    if not len(jumps):
        return []
    when = ", ".join(f"{before - poses.span[0]:.2f}" for before, _ in jumps[:5]) + (", ..." if len(jumps) > 5 else "")
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    return [f"poses jump {times}, {when} s after they start: the map begins anew there, and no window reaches across"]
