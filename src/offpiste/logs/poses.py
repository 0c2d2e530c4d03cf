"""Poses of the vehicle at any moment of a log, and the jumps in them, across which no map and no window may reach."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import median_filter

from offpiste.core.errors import RigError
from offpiste.core.geometry import rotation_from_quaternion
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.native.compilation import POSES


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
        matrix = np.empty((len(time), 4, 4))
        samples = (self.position.time, self.position.values, self.orientation.time, self.orientation.values)
        unknown = np.concatenate((self.jumps, self.unknown))
        put_poses(*(np.ascontiguousarray(each, np.float64) for each in (time, *samples, unknown)), self.max_gap, matrix)
        return matrix

    def known(self, time: float) -> float:
        """When the pose at a moment was known [s]: the stamp of the sample after it; infinite at the end of the log."""
        stamps = (channel.time for channel in (self.position, self.orientation))
        return float(max(np.append(t, np.inf)[np.searchsorted(t, time, side="right")] for t in stamps))

    def stretch(self, time: float) -> int:
        """Number of jumps until a moment [s]: positions of one stretch fit together."""
        return int(self.stretches(np.array(time)))

    def stretches(self, times: Float[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
        """`stretch` of many moments."""
        return np.asarray(np.searchsorted(self.jumps[:, 1], times, side="right"))


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


# Compiled loops; the plain reference, in NumPy and SciPy, is in the tests (`tests/logs/test_poses.py`).


@POSES.inlined
def sample_after(stamps, at, max_gap):  # type: ignore[no-untyped-def]
    """Number of the first sample after a moment; -1 outside of the record and in gaps."""
    if not stamps[0] <= at <= stamps[-1]:
        return -1
    after = min(np.searchsorted(stamps, at, side="right"), len(stamps) - 1)
    return after if stamps[after] - stamps[after - 1] <= max_gap else -1


@POSES.inlined
def slerp(one, other, share):  # type: ignore[no-untyped-def]
    """A unit quaternion between two of any length (Shoemake, SIGGRAPH 1985), the short way round."""
    squares = product = others = 0.0
    for k in range(4):
        squares, product, others = squares + one[k] * one[k], product + one[k] * other[k], others + other[k] * other[k]
    sign = -1.0 if product < 0.0 else 1.0
    cosine = abs(product) / np.sqrt(squares) / np.sqrt(others)
    angle = 0.0 if cosine > 1.0 else np.arccos(cosine)
    sine, begin, end = np.sin(angle), 1.0 - share, share
    if not sine < 1e-6:
        begin, end = np.sin((1.0 - share) * angle) / sine, np.sin(share * angle) / sine
    end *= sign
    x, y = begin * one[0] + end * other[0], begin * one[1] + end * other[1]
    z, w = begin * one[2] + end * other[2], begin * one[3] + end * other[3]
    length = np.sqrt(x * x + y * y + z * z + w * w)
    return x / length, y / length, z / length, w / length


@POSES.entry
def put_poses(time, stamps, positions, turned, quaternions, unknown, max_gap, matrices):  # type: ignore[no-untyped-def]
    """Put `world_from_body` at each moment; not a number where it is unknown.

    Args:
        time: [n] [s].
        stamps, positions: samples of the position [p] [s], [p, 3] [m].
        turned, quaternions: stamps and samples xyzw of the orientation [q] [s], [q, 4].
        unknown: moments between which nothing is known [u, 2] [s].
        max_gap: nothing is interpolated between samples further apart [s].
        matrices: [n, 4, 4], overwritten.
    """
    for n in range(len(time)):
        at, matrix = time[n], matrices[n]
        after, turn = sample_after(stamps, at, max_gap), sample_after(turned, at, max_gap)
        for u in range(len(unknown)):
            if unknown[u, 0] < at < unknown[u, 1]:
                after = -1
        matrix[:] = np.nan
        if after < 0 or turn < 0:
            continue
        share = (at - turned[turn - 1]) / (turned[turn] - turned[turn - 1])
        x, y, z, w = slerp(quaternions[turn - 1], quaternions[turn], share)
        if not np.isfinite(w):
            continue
        share = (at - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
        for axis in range(3):
            matrix[axis, 3] = (1.0 - share) * positions[after - 1, axis] + share * positions[after, axis]
        matrix[0, 0], matrix[0, 1], matrix[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        matrix[1, 0], matrix[1, 1], matrix[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        matrix[2, 0], matrix[2, 1], matrix[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
        matrix[3, 0] = matrix[3, 1] = matrix[3, 2] = 0.0
        matrix[3, 3] = 1.0


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


def find_jumps(position: Channel, *headings: Channel) -> Float[np.ndarray, "j 2"]:
    """Last moment before and first moment after each jump, in the order of time [s].

    Args:
        headings: quaternions, and yaw, wrapped or not.
    """
    result = [_between(position, position_excess(position) > FARTHEST)]
    for heading in headings:
        limit = np.maximum(_TURN, _TURN_RATE * np.diff(heading.time))
        result.append(_between(heading, _turns(heading) > limit))
    jumps = np.concatenate(result)
    return jumps[np.lexsort(jumps.T[::-1])]


def position_excess(position: Channel) -> Float[np.ndarray, " m"]:
    """Excess of each of the m = n - 1 steps over what the speed until then explains [m]."""
    step = np.linalg.norm(np.diff(position.values, axis=0), axis=1)
    dt = np.diff(position.time)
    speed = median_filter(step / dt, _UNTIL, mode="nearest", origin=_UNTIL // 2)
    return step - (speed + _ACCELERATION * dt) * dt


def _turns(heading: Channel) -> Float[np.ndarray, " m"]:
    """Angles between neighbouring samples of quaternions or of yaw [rad]."""
    if heading.values.shape[1] == 1:
        return np.abs((np.diff(heading.values[:, 0]) + np.pi) % (2 * np.pi) - np.pi)
    matrix = rotation_from_quaternion(heading.values)
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
