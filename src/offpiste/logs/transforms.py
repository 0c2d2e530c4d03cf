"""Fixed transforms between frames, and topics for single pairs of frames.

Each pair of frames of `/tf` is a topic such as `/tf odom -> base_link`, with the fields of
geometry_msgs/TransformStamped.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError
from offpiste.core.geometry import rotation_from_quaternion

TRANSFORMS: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Message types with transforms."""
STAMPED: Final = "geometry_msgs/msg/TransformStamped"
STAMPED_FIELDS: Final = (
    *(f"transform.translation.{axis}" for axis in "xyz"),
    *(f"transform.rotation.{axis}" for axis in "xyzw"),
)
_BODIES = re.compile(r"base|body|vehicle|chassis|ego|imu|(^|[/_])(car|robot)([/_]|$)", re.IGNORECASE)
"""Names of vehicle frames."""
_WORLDS = re.compile(r"odom|map|world|earth|local|enu|utm|camera_init", re.IGNORECASE)
"""Names of world frames."""
_SOUGHT, _MORE = 10_000, 500
"""Number of messages searched for a first pose of the vehicle, and for other frames after it."""
_LISTED = 5
"""Largest number of listed transforms besides poses of the vehicle: a robot may have one for each joint."""
_NAME = re.compile(r"(\S+) (\S+) -> (\S+)")


class FramePair(NamedTuple):
    """Pair of frames of some transforms of a topic."""

    topic: str
    parent: str
    child: str

    @property
    def name(self) -> str:
        """Name of the pair's own topic: the recorded topic and its frames."""
        return f"{self.topic} {self.parent} -> {self.child}"

    @property
    def is_of_a_body(self) -> bool:
        """True for a possible pose of the vehicle, by the names of the frames."""
        return bool(_WORLDS.search(self.parent) and _BODIES.search(self.child))

    @property
    def is_inverse(self) -> bool:
        """True for a possible inverse of the vehicle's pose, by the names of the frames."""
        return bool(_BODIES.search(self.parent) and _WORLDS.search(self.child)) and not self.is_of_a_body

    def of(self, message: Any) -> list[Any]:
        """Return the transforms of a message between these frames."""
        return [one for one in message.transforms if frames(one) == (self.parent, self.child)]


def frame_pair(name: str) -> FramePair | None:
    """Return the frames in the name of a topic; None for other topics."""
    found = _NAME.fullmatch(name)
    return None if found is None else FramePair(*found.groups())


def listed(topics: Iterable[str]) -> list[str]:
    """Return the topics to list in messages: of transforms, only poses of the vehicle and a handful of others."""
    names = list(topics)
    others = [name for name in names if (one := frame_pair(name)) is not None and not one.is_of_a_body]
    left_out = set(others[_LISTED:])
    return [name for name in names if name not in left_out]


def frame_pairs(topic: str, messages: Iterable[Any]) -> Iterator[FramePair]:
    """Yield the frames of each transform of a topic until soon after the first pose of the vehicle.

    A localiser that starts late is found within the first ten thousand messages.
    """
    left = _SOUGHT
    for message in messages:
        for one in message.transforms:
            key = FramePair(topic, *frames(one))
            if frame_pair(key.name) == key:
                yield key
                if key.is_of_a_body:
                    left = min(left, _MORE)
        left -= 1
        if left <= 0:
            return


def frames(message: Any) -> tuple[str, str]:
    """Return the parent and the child of a geometry_msgs/TransformStamped."""
    return message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")


@dataclass(frozen=True)
class Transform:
    """Fixed transform `parent_from_child` [m]."""

    parent: str
    child: str
    matrix: Float[np.ndarray, "4 4"]


def between(transforms: Sequence[Transform], parent: str, child: str, *, path: Path) -> Float[np.ndarray, "4 4"]:
    """Return `parent_from_child` by a chain of fixed transforms, up or down the tree."""
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
    how = "give body_from_camera or body_from_lidar in the rig"
    if child not in known:
        what = f"no fixed transform joins '{child}' to '{parent}'; frames with transforms: "
        what += ", ".join(sorted(steps)) or "none"
        raise LogError(what, where=path, how=f"fix frames.body or frames.topics, or {how}")
    if not _is_rigid(known[child]):
        raise LogError(f"the transform from '{parent}' to '{child}' is not rigid", where=path, how=how)
    return known[child]


def transform_of(message: Any) -> Transform:
    """Return the transform of a geometry_msgs/TransformStamped."""
    t, q = message.transform.translation, message.transform.rotation
    matrix = np.eye(4)
    matrix[:3, 3] = t.x, t.y, t.z
    with np.errstate(invalid="ignore"):  # quaternions of zeros are refused when used
        matrix[:3, :3] = rotation_from_quaternion(np.array([[q.x, q.y, q.z, q.w]]))[0]
    return Transform(*frames(message), matrix)


def _is_rigid(matrix: Float[np.ndarray, "4 4"]) -> bool:
    turn = matrix[:3, :3]
    return bool(np.isfinite(matrix).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-3))
