"""Transforms of a log: the chain of fixed ones between two frames, and each pair of frames of `/tf` as a topic.

Such a topic is called `/tf odom -> base_link`, and its fields are those of geometry_msgs/TransformStamped. Messages of
several senders on one topic are topics of their own as well, by their frames: `/odom odom -> base_link`, `/imu @ imu`.
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
"""Types of messages that carry them."""
STAMPED: Final = "geometry_msgs/msg/TransformStamped"
STAMPED_FIELDS: Final = (
    *(f"transform.translation.{axis}" for axis in "xyz"),
    *(f"transform.rotation.{axis}" for axis in "xyzw"),
)
_BODIES = re.compile(r"base|body|vehicle|chassis|ego|imu|(^|[/_])(car|robot)([/_]|$)", re.IGNORECASE)
"""Frames that a pose is of, by their names, where they move in one of `_WORLDS`."""
_WORLDS = re.compile(r"odom|map|world|earth|local|enu|utm|camera_init", re.IGNORECASE)
_SOUGHT, _MORE = 10_000, 500
"""Messages in which a first body is sought, and those from there on that are asked for other frames."""
_LISTED = 5
"""Transforms that messages list besides those of a body in a world: a robot may have one for each of its joints."""
_NAME = re.compile(r"(\S+) (?:(\S+) -> (\S+)|@ (\S+))")
_UNNAMED = "(none)"


class FramePair(NamedTuple):
    """Two frames whose transforms, or messages, a topic has among others; or one frame, and "" for the child."""

    topic: str
    parent: str
    child: str

    @property
    def name(self) -> str:
        """What its own topic is called."""
        parent, child = self.parent or _UNNAMED, self.child or _UNNAMED
        return f"{self.topic} {parent} -> {child}" if self.child else f"{self.topic} @ {parent}"

    @property
    def is_of_a_body(self) -> bool:
        """Whether it is of a body in a world, by the names of the frames: such a one may be the pose."""
        return bool(_WORLDS.search(self.parent) and _BODIES.search(self.child))

    @property
    def is_inverse(self) -> bool:
        """Whether it is of a world in a body: a pose the other way round."""
        return bool(_BODIES.search(self.parent) and _WORLDS.search(self.child)) and not self.is_of_a_body

    def of(self, message: Any) -> list[Any]:
        """Those of it among the transforms of a message."""
        return [one for one in message.transforms if frames(one) == (self.parent, self.child)]


def frame_pair(name: str) -> FramePair | None:
    """The frames whose topic is called so; None where it is the name of any other topic."""
    found = _NAME.fullmatch(name)
    if found is None:
        return None
    topic, parent, child, only = found.groups()
    return FramePair(topic, *("" if one in (None, _UNNAMED) else one for one in (parent or only, child)))


def listed(topics: Iterable[str]) -> list[str]:
    """Names of topics for messages and guesses: of transforms those of a body in a world, and a handful of others."""
    names = list(topics)
    others = [name for name in names if (one := frame_pair(name)) is not None and not one.is_of_a_body]
    left_out = set(others[_LISTED:])
    return [name for name in names if name not in left_out]


def frame_pairs(topic: str, messages: Iterable[Any]) -> Iterator[FramePair]:
    """Each transform of the first messages of a topic, in their order.

    They end soon after the first body in a world; a localiser that starts late is found among the first ten thousand.
    """
    left, found = _SOUGHT, False
    for message in messages:
        for one in message.transforms:
            key = FramePair(topic, *frames(one))
            if frame_pair(key.name) == key:
                yield key
                if key.is_of_a_body and not found:
                    left, found = min(left, _MORE), True
        left -= 1
        if left <= 0:
            return


def frames(message: Any) -> tuple[str, str]:
    """Parent and child of a geometry_msgs/TransformStamped."""
    return message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")


@dataclass(frozen=True)
class Transform:
    """A fixed transform `parent_from_child` [m]."""

    parent: str
    child: str
    matrix: Float[np.ndarray, "4 4"]


def between(transforms: Sequence[Transform], parent: str, child: str, *, path: Path) -> Float[np.ndarray, "4 4"]:
    """`parent_from_child` between two frames that a chain of fixed transforms joins, up or down the tree.

    Raises:
        LogError: no chain joins them, or a transform in it is not rigid.
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
            how="fix frames.body or frames.topics, or give body_from_camera or body_from_lidar in the rig",
        )
    if not _is_rigid(known[child]):
        what = f"the transform from '{parent}' to '{child}' is not rigid"
        raise LogError(what, where=path, how="give body_from_camera or body_from_lidar in the rig")
    return known[child]


def transform_of(message: Any) -> Transform:
    """The transform of a geometry_msgs/TransformStamped."""
    t, q = message.transform.translation, message.transform.rotation
    matrix = np.eye(4)
    matrix[:3, 3] = t.x, t.y, t.z
    with np.errstate(invalid="ignore"):  # a quaternion of zeros is found where the transform is used
        matrix[:3, :3] = rotation_from_quaternion(np.array([[q.x, q.y, q.z, q.w]]))[0]
    return Transform(*frames(message), matrix)


def _is_rigid(matrix: Float[np.ndarray, "4 4"]) -> bool:
    turn = matrix[:3, :3]
    return bool(np.isfinite(matrix).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-3))
