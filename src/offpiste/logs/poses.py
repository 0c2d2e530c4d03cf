"""Where the vehicle was at any moment of a log."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from offpiste.errors import RigError
from offpiste.geometry import rotation_from_quaternion
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.logs.jumps import find_jumps


@dataclass(frozen=True)
class Poses:
    """Poses `world_from_body` between samples: straight lines, and even turns the short way round.

    Attributes:
        position: [m].
        orientation: quaternions xyzw.
        max_gap: nothing is interpolated between samples further apart [s].
        jumps: the last moment before and the first one after each place where they jump [s]; nothing is interpolated
            between the two, and what was mapped before fits nothing after.
    """

    position: Channel
    orientation: Channel
    max_gap: float
    jumps: Float[np.ndarray, "j 2"] = field(default_factory=lambda: np.zeros((0, 2)))

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
        for before, after in self.jumps:
            matrix[(time > before) & (time < after)] = np.nan
        matrix[~np.isfinite(matrix).all(axis=(1, 2))] = np.nan
        return matrix

    def stretch(self, time: float) -> int:
        """How many jumps there were until a moment [s]: places of one stretch fit together."""
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
    return Poses(position, orientation, drive.rig.clock.max_gap, find_jumps(position, orientation))


def slerp(orientation: Channel, at: Float[np.ndarray, " n"], *, max_gap: float) -> Float[np.ndarray, "n 4"]:
    """Quaternions between samples (Shoemake, SIGGRAPH 1985); NaN outside of the record and across gaps."""
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
    mixed[np.isnan(orientation.linear(at, max_gap=max_gap)[:, 0])] = np.nan
    return mixed
