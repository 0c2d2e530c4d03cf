"""Interpolated poses of the vehicle."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.errors import RigError
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.native.compilation import POSES


@dataclass(frozen=True)
class Poses:
    """Poses `world_from_body`, interpolated linearly in position and by slerp in orientation.

    Attributes:
        position: [m].
        orientation: quaternions xyzw.
        max_gap: largest gap between samples to interpolate across [s].
        jumps: stamps before and after each jump [s]; poses between them are unknown, and maps from before do not fit
            after.
        unknown: stamps before and after each run of implausible samples [s]; poses between them are unknown.
    """

    position: Channel
    orientation: Channel
    max_gap: float
    jumps: Float[np.ndarray, "j 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    unknown: Float[np.ndarray, "u 2"] = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of a known pose [s]."""
        p, q = self.position.time, self.orientation.time
        return float(max(p[0], q[0])), float(min(p[-1], q[-1]))

    def at(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """Return `world_from_body` at given times [s]; NaN outside the log and across gaps and jumps."""
        matrix = np.empty((len(time), 4, 4))
        samples = (self.position.time, self.position.values, self.orientation.time, self.orientation.values)
        unknown = np.concatenate((self.jumps, self.unknown))
        put_poses(*(np.ascontiguousarray(each, np.float64) for each in (time, *samples, unknown)), self.max_gap, matrix)
        return matrix

    def known(self, time: float) -> float:
        """Return the stamp of the sample after a time [s], when its pose became known; infinite at the log's end."""
        stamps = (channel.time for channel in (self.position, self.orientation))
        return float(max(np.append(t, np.inf)[np.searchsorted(t, time, side="right")] for t in stamps))

    def stretch(self, time: float) -> int:
        """Return the number of jumps until a time [s]; positions with the same number are consistent."""
        return int(self.stretches(np.array(time)))

    def stretches(self, times: Float[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
        """Return `stretch` at many times."""
        return np.asarray(np.searchsorted(self.jumps[:, 1], times, side="right"))


def poses_from_drive(drive: Drive) -> Poses:
    """Return the poses of a drive, which need positions with z and full orientations."""
    position, orientation = drive.channels.get("position"), drive.channels.get("orientation")
    if orientation is None or position is None or position.values.shape[1] != 3:
        what = f"{drive.name}: cameras and LiDARs need positions with z, and orientations as quaternions"
        raise RigError(what, how="give channels.position three fields, and channels.orientation")
    return Poses(position, orientation, drive.rig.clock.max_gap, drive.faults.breaks(), drive.faults.unknown())


# Compiled loops; their reference in NumPy and SciPy is in tests/logs/test_poses.py.


@POSES.inlined
def sample_after(stamps, at, max_gap):  # type: ignore[no-untyped-def]
    """Return the index of the first sample after a time; -1 outside the record and in gaps."""
    if not stamps[0] <= at <= stamps[-1]:
        return -1
    after = min(np.searchsorted(stamps, at, side="right"), len(stamps) - 1)
    return after if stamps[after] - stamps[after - 1] <= max_gap else -1


@POSES.inlined
def slerp(one, other, share):  # type: ignore[no-untyped-def]
    """Interpolate between quaternions of any length along the shorter arc (Shoemake, SIGGRAPH 1985)."""
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
    """Write `world_from_body` at each time into `matrices` [n, 4, 4]; NaN where unknown.

    Args:
        time: [n] [s].
        stamps, positions: samples of the position [p] [s], [p, 3] [m].
        turned, quaternions: stamps and samples xyzw of the orientation [q] [s], [q, 4].
        unknown: intervals without known poses [u, 2] [s].
        max_gap: largest gap between samples to interpolate across [s].
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


def jump_note(poses: Poses) -> list[str]:
    """Return a note on the times of the jumps, if any."""
    jumps = poses.jumps
    if not len(jumps):
        return []
    when = ", ".join(f"{before - poses.span[0]:.2f}" for before, _ in jumps[:5]) + (", ..." if len(jumps) > 5 else "")
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    return [f"poses jump {times}, {when} s after they start: the map begins anew there, and no window reaches across"]
