"""Interpolated poses of the vehicle."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.errors import RigError
from offpiste.core.geometry import rotation_from_quaternion
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive


@dataclass(frozen=True)
class Poses:
    """Poses `world_from_body`, interpolated linearly in position and by slerp in orientation."""

    position: Channel  # [m]
    orientation: Channel  # quaternions xyzw
    max_gap: float  # largest gap between samples to interpolate across [s]
    # Stamps before and after each jump, and each run of implausible samples [s]. Poses between them are unknown, and
    # maps from before a jump do not fit after it.
    jumps: Float[np.ndarray, "j 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    unknown: Float[np.ndarray, "u 2"] = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of a known pose [s]."""
        p, q = self.position.time, self.orientation.time
        return float(max(p[0], q[0])), float(min(p[-1], q[-1]))

    def at(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """Return `world_from_body` at given times [s]; NaN outside the log and across gaps and jumps."""
        samples = (self.position.time, self.position.values, self.orientation.time, self.orientation.values)
        matrix = interpolated(time, *samples, self.max_gap)
        begin, end = np.sort(np.concatenate((self.jumps, self.unknown)), axis=0).T
        matrix[np.searchsorted(begin, time) > np.searchsorted(end, time, side="right")] = np.nan
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


def interpolated(
    time: Float[np.ndarray, " n"],
    stamps: Float[np.ndarray, " p"],
    positions: Float[np.ndarray, "p 3"],
    turned: Float[np.ndarray, " q"],
    quaternions: Float[np.ndarray, "q 4"],
    max_gap: float,
) -> Float[np.ndarray, "n 4 4"]:
    """Return `world_from_body` at given times [s]; NaN outside the samples and across gaps.

    Args:
        stamps, positions: samples of the position [s], [m].
        turned, quaternions: stamps [s] and samples xyzw of the orientation.
        max_gap: largest gap between samples to interpolate across [s].
    """
    matrix = np.full((len(time), 4, 4), np.nan)
    after, share = _between(stamps, time, max_gap)
    turn, turn_share = _between(turned, time, max_gap)
    with np.errstate(invalid="ignore", divide="ignore"):
        quaternion = _slerp(quaternions[turn - 1], quaternions[turn], turn_share)
    known = np.isfinite(share) & np.isfinite(quaternion[:, 3])
    after, share = after[known], share[known, None]
    matrix[known, :3, :3] = rotation_from_quaternion(quaternion[known])
    matrix[known, :3, 3] = (1 - share) * positions[after - 1] + share * positions[after]
    matrix[known, 3] = [0, 0, 0, 1]
    return matrix


def _between(
    stamps: Float[np.ndarray, " p"], time: Float[np.ndarray, " n"], max_gap: float
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the sample after each time, and the share of the gap before it that has passed; NaN where unknown."""
    after = np.searchsorted(stamps, time, side="right").clip(max=len(stamps) - 1)
    begin, end = stamps[after - 1], stamps[after]
    known = (stamps[0] <= time) & (time <= stamps[-1]) & (end - begin <= max_gap) & (begin < end)
    return after, np.divide(time - begin, end - begin, out=np.full(len(time), np.nan), where=known)


def _slerp(
    one: Float[np.ndarray, "n 4"], other: Float[np.ndarray, "n 4"], share: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 4"]:
    """Interpolate between quaternions of any length along the shorter arc (Shoemake, SIGGRAPH 1985)."""
    product, squares, others = (np.einsum("nk,nk->n", a, b) for a, b in ((one, other), (one, one), (other, other)))
    angle = np.arccos(np.minimum(np.abs(product) / np.sqrt(squares) / np.sqrt(others), 1))
    sine = np.sin(angle)
    flat = sine < 1e-6
    begin = np.where(flat, 1 - share, np.sin((1 - share) * angle) / sine)
    end = np.where(flat, share, np.sin(share * angle) / sine)
    return begin[:, None] * one + np.where(product < 0, -end, end)[:, None] * other


def jump_note(poses: Poses) -> list[str]:
    """Return a note on the times of the jumps, if any."""
    jumps = poses.jumps
    if not len(jumps):
        return []
    when = ", ".join(f"{before - poses.span[0]:.2f}" for before, _ in jumps[:5]) + (", ..." if len(jumps) > 5 else "")
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    return [f"poses jump {times}, {when} s after they start: the map restarts there, and no window spans a jump"]
