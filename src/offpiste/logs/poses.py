"""Where the vehicle was at any moment of a log.

Where poses jump: a vehicle cannot be there so soon. Maps and windows must not reach across.

Where sensors sit on the body, from a log's fixed transforms.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from offpiste.errors import LogError, RigError
from offpiste.geometry import rotation_from_quaternion
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.logs.log import Transform


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


FARTHEST: Final = 1.0
"""A step that is longer than the speed explains by more than this is a jump [m]: five cells of the map. Shorter ones,
GPS has many; `offpiste inspect` lists them."""
_AROUND: Final = 21
"""Samples whose median speed explains a step."""
_ACCELERATION: Final = 10.0
"""No vehicle changes its speed faster [m/s^2]; counts where samples are far apart."""
_TURN: Final = np.deg2rad(20.0)
"""A turn between two samples that is larger than this ..."""
_TURN_RATE: Final = 4.0
"""... and than what the vehicle could turn meanwhile [rad/s] is a jump."""


def find_jumps(position: Channel, orientation: Channel | None = None) -> Float[np.ndarray, "j 2"]:
    """The last moment before and the first one after each jump, in the order of time [s]."""
    found = [_between(position, position_excess(position) > FARTHEST)]
    if orientation is not None and len(orientation.time) > 1:
        turned = _turns(orientation)
        limit = np.maximum(_TURN, _TURN_RATE * np.diff(orientation.time))
        found.append(_between(orientation, turned > limit))
    jumps = np.concatenate(found)
    return jumps[np.lexsort(jumps.T[::-1])]


def position_excess(position: Channel) -> Float[np.ndarray, " m"]:
    """By how much each of the m = n - 1 steps is longer than the speed around it explains [m]."""
    step = np.linalg.norm(np.diff(position.values, axis=0), axis=1)
    dt = np.diff(position.time)
    speed = median_filter(step / dt, _AROUND, mode="nearest")
    return step - (speed + _ACCELERATION * dt) * dt


def _turns(orientation: Channel) -> Float[np.ndarray, " m"]:
    """Angle between neighbouring samples [rad]."""
    matrix = rotation_from_quaternion(orientation.values)
    trace = np.einsum("nij,nij->n", matrix[:-1], matrix[1:])
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def _between(channel: Channel, jumps: np.ndarray) -> Float[np.ndarray, "j 2"]:
    first = np.flatnonzero(jumps)
    return np.stack((channel.time[first], channel.time[first + 1]), axis=1)


def between(transforms: Sequence[Transform], parent: str, child: str, *, path: Path) -> Float[np.ndarray, "4 4"]:
    """`parent_from_child` along the chain of fixed transforms that joins two frames, up and down the tree.

    Raises:
        LogError: no chain joins them, or a transform on it is no rotation and shift.
    """
    steps: dict[str, list[tuple[str, Float[np.ndarray, "4 4"]]]] = {}
    for t in transforms:
        usable = _is_rigid(t.matrix)
        steps.setdefault(t.parent, []).append((t.child, t.matrix))
        steps.setdefault(t.child, []).append((t.parent, np.linalg.inv(t.matrix) if usable else t.matrix))
    known, border = {parent: np.eye(4)}, [parent]
    while border and child not in known:
        frame = border.pop(0)
        for other, matrix in steps.get(frame, []):
            if other not in known:
                known[other] = known[frame] @ matrix
                border.append(other)
    if child not in known:
        frames = ", ".join(sorted(steps)) or "none"
        raise LogError(
            f"no fixed transform joins '{child}' to '{parent}'; frames with transforms: {frames}",
            where=path,
            how="mend frames.body or frames.topics, or give body_from_camera or body_from_lidar in the rig",
        )
    if not _is_rigid(known[child]):
        what = f"the transform from '{parent}' to '{child}' is no rotation and shift"
        raise LogError(what, where=path, how="give body_from_camera or body_from_lidar in the rig")
    return known[child]


def _is_rigid(matrix: Float[np.ndarray, "4 4"]) -> bool:
    turn = matrix[:3, :3]
    return bool(np.isfinite(matrix).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-3))
