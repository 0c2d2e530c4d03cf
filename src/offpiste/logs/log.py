"""A recorded log as the rest sees it: topics with numbers, cameras and LiDARs, whatever its format; opening one.

A format is one class: a subclass of `Log` that registers itself in `LOG_FORMATS`. `offpiste.logs.formats` has those
that ship, `examples/extending/euroc.py` shows one added from outside.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from offpiste.core.errors import LogError, did_you_mean
from offpiste.core.registry import Registry
from offpiste.logs.transforms import Transform, listed
from offpiste.rig.camera import CameraModel
from offpiste.rig.channels import Clock, topic_in_words
from offpiste.rig.labels import without_comment

LOG_FORMATS: "Registry[type[Log]]" = Registry("log format", package="offpiste.logs.formats", error=LogError)
"""Log formats by name; `offpiste.logs.open_log` chooses the one that recognises a path."""

JOINT_ARRAYS: Final = {"position": "", "velocity": "_vel", "effort": "_effort"}
"""Arrays of sensor_msgs/JointState, and what is added to a joint's name in `Topic.joints`: a position is the joint."""


@dataclass(frozen=True)
class Topic:
    """A named stream of samples, described before its samples are read.

    Attributes:
        type: message type, or the kind of file.
        count: number of samples.
        fields: names of the numeric fields; empty where they are known only from a message, and there is none.
        units: of fields, by name, where the log states them beside the names (`offpiste.rig.labels`).
        joints: what messages call the entries of their arrays, by field (sensor_msgs/JointState).
        unread: why columns of the file are not among the fields, by name.
        part_of: the topic among whose messages it is found, counted in the first of them; "" for one of the log's own.
    """

    name: str
    type: str
    count: int
    fields: tuple[str, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    joints: Mapping[str, str] = field(default_factory=dict)
    unread: Mapping[str, str] = field(default_factory=dict)
    part_of: str = ""

    def in_words(self, name: str) -> str:
        """A field with the name of its joint: `position[1] (steering)`."""
        return f"{name} ({self.joints[name]})" if name in self.joints else name

    def joint_of(self, name: str) -> str:
        """What messages call the joint of a field, without what tells velocities and efforts apart."""
        return self.joints[name].removesuffix(JOINT_ARRAYS[name.partition("[")[0]]) if name in self.joints else ""

    def fields_here(self, fields: Sequence[str], joints: Sequence[str]) -> tuple[str, ...]:
        """A rig's fields by their names in this log: entries of arrays by joints, columns without a comment's sign.

        Raises:
            LogError: the topic has no joint of such a name.
        """
        if not joints or not self.joints:
            return tuple(name if name in self.fields else without_comment(name) for name in fields)
        own = {(one.partition("[")[0], self.joint_of(one)): one for one in reversed(list(self.joints))}
        wanted = [(one.partition("[")[0], joint) for one, joint in zip(fields, joints, strict=True)]
        if missing := [pair for pair in wanted if pair not in own]:
            known = ", ".join(dict.fromkeys(joint for array, joint in reversed(own) if array == missing[0][0]))
            raise LogError(
                f"topic '{self.name}' has no joint '{missing[0][1]}' in {missing[0][0]}",
                how=f"fix joints in the rig; it has: {known or 'none'}",
            )
        return tuple(own[pair] for pair in wanted)


@dataclass(frozen=True)
class Samples:
    """Numbers as recorded, in the order of the file; nothing is sorted, dropped or converted yet.

    Attributes:
        time: stamps [s].
        values: one column a field.
    """

    time: Float[np.ndarray, " n"]
    values: Float[np.ndarray, "n k"]


@dataclass(frozen=True)
class RawImage:
    """An image as recorded.

    Attributes:
        time: stamp [s].
        frame: optical frame of the camera.
        pixels: RGB in as many bits as were recorded (`measurements.in_eight_bits`); None where it cannot be decoded.
    """

    time: float
    frame: str
    pixels: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"] | None


@dataclass(frozen=True)
class RawCloud:
    """A cloud as recorded.

    Attributes:
        time: stamp [s].
        frame: frame of the points.
        points: records with x, y, z and more.
    """

    time: float
    frame: str
    points: np.ndarray


class SetBack(NamedTuple):
    """A step back of a clock.

    Attributes:
        time: last stamp before it [s].
        by: how far [s].
    """

    time: float
    by: float


_Raw = TypeVar("_Raw", RawImage, RawCloud)


class Log(ABC):
    """A recorded drive; `offpiste.logs.open_log` chooses the format.

    A format overrides `recognises`, `topics` and `_read`. One with cameras or LiDARs sets `has_sensors` and overrides
    the methods about them; each message is read when its turn comes, so that memory does not grow with the log.

    Attributes:
        description: the format in messages, e.g. "a KITTI raw drive".
        has_sensors: whether the format can hold images or point clouds.
        has_messages: whether `messages` gives decoded ROS messages.
        has_clock_unit: whether the rig's clock gives the unit of the stamps.
        has_arrivals: whether samples carry their time of arrival beside their own stamp; `stamps` chooses one.
        warnings: what a damaged or ambiguous log made the reader leave out or guess, in words.
    """

    description: ClassVar[str] = ""
    has_sensors: ClassVar[bool] = False
    has_messages: ClassVar[bool] = False
    has_arrivals: ClassVar[bool] = False
    has_clock_unit: ClassVar[bool] = False
    path: Path
    warnings: tuple[str, ...] = ()

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether a file or folder, which exists, has this format; quick."""
        return False

    @classmethod
    def open(cls, path: Path, clock: Clock) -> "Log":
        """A log of this format.

        Args:
            clock: the rig's; formats that know their clock ignore it.

        Raises:
            LogError: the log cannot be read.
        """
        return cls(path)  # type: ignore[call-arg]

    @property
    @abstractmethod
    def topics(self) -> dict[str, Topic]:
        """Topics by name."""

    @property
    def set_back(self) -> SetBack | None:
        """Step back of the recorder's clock, which puts samples before and after it in one order of arrival."""
        return None

    @property
    def clock(self) -> Clock:
        """The clock that stamps are read by: of a table, the column that is taken for time, and its unit."""
        return Clock()

    @abstractmethod
    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples: ...

    def read(self, topic: str, fields: Sequence[str], *, stamps: str = "header") -> Samples:
        """Samples of some fields of a topic.

        Args:
            topic: name in `topics`.
            fields: names in the topic's `fields`.
            stamps: "header" (a message's own stamp where it has one) or "receive"; ignored without `has_arrivals`.

        Raises:
            LogError: no such topic or field, no sample in it, or the file is damaged there.
        """
        result = self._find(topic)
        if result.count == 0:
            what, how = f"{topic_in_words(topic)} is empty", "declare its channels absent in the rig"
            raise LogError(what, where=self.path, how=how)
        if missing := [f for f in fields if f not in result.fields]:
            what = f"{topic_in_words(topic)} ({result.type}) has no field '{missing[0]}'"
            what = result.unread.get(missing[0], what)
            how = f"it has: {', '.join(result.fields[:40]) or 'no numeric field'}"
            raise LogError(what, where=self.path, how=how)
        return self._read(result, fields, stamps)

    def stamps(self, topic: str, *, stamps: str = "header") -> Float[np.ndarray, " n"]:
        """Stamps of all messages of a topic [s], in the order of the file, without decoding more than needed.

        Raises:
            LogError: as for `read`.
        """
        return self.read(topic, self._find(topic).fields[:1], stamps=stamps).time

    def messages(self, topic: str, *, stamps: str = "header") -> Iterator[tuple[float, Any]]:
        """Stamps [s] and decoded ROS messages of a topic, in the order of the file, one at a time.

        Raises:
            LogError: no such topic, a type that cannot be decoded, or the format has no messages.
        """
        raise LogError("this format holds no messages", where=self.path, how=f"give {_formats('has_messages')}")

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Fixed transforms between frames; none where the log has none.

        Args:
            topics: those that carry them, where the format needs to know (`frames.topics` of the rig).

        Raises:
            LogError: the log is damaged there.
        """
        return []

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Calibration of a camera, and `camera_from_image` (`offpiste.rig.camera.model_from_message`).

        Raises:
            LogError: no calibration there, or one that is not supported.
        """
        raise self.no_sensors()

    def frame(self, topic: str) -> str:
        """Frame of a topic's first message.

        Raises:
            LogError: there is no message.
        """
        raise self.no_sensors()

    def images(self, topic: str, *, stamps: str = "header") -> Iterator[RawImage]:
        """Images in the order of the file.

        Raises:
            LogError: the topic holds something else.
        """
        raise self.no_sensors()

    def clouds(self, topic: str, *, stamps: str = "header") -> Iterator[RawCloud]:
        """Point clouds in the order of the file.

        Raises:
            LogError: the topic holds something else.
        """
        raise self.no_sensors()

    def images_at(self, topic: str, times: Float[np.ndarray, " n"], *, stamps: str = "header") -> Iterator[RawImage]:
        """Those images whose stamps are given, in the order of the file; a format with an index reads no others.

        Args:
            times: some of `stamps(topic)` [s].

        Raises:
            LogError: as for `images`.
        """
        return _picked(self.images(topic, stamps=stamps), times)

    def clouds_at(self, topic: str, times: Float[np.ndarray, " n"], *, stamps: str = "header") -> Iterator[RawCloud]:
        """Those point clouds whose stamps are given (see `images_at`)."""
        return _picked(self.clouds(topic, stamps=stamps), times)

    def no_sensors(self) -> LogError:
        """Error of a log whose format has no images and no clouds."""
        how = f"give {_formats('has_sensors')}"
        return LogError("this format holds no images or clouds", where=self.path, how=how)

    def _find(self, topic: str) -> Topic:
        result = self.topics.get(topic)
        if result is None:
            known = ", ".join(listed(sorted(self.topics))) or "none"
            how = f"{did_you_mean(topic, self.topics)}it has: {known}"
            raise LogError(f"no topic '{topic}'", where=self.path, how=how)
        return result


def contents_of(folder: Path) -> tuple[list[str], list[str]]:
    """Return the names of the logs directly in a folder, and of everything else that is not hidden."""
    formats = [kind for _, kind in LOG_FORMATS.items()]
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    logs = [name for name in names if any(kind.recognises(folder / name) for kind in formats)]
    return logs, [name for name in names if name not in logs]


def _picked(raw: Iterator[_Raw], times: Float[np.ndarray, " n"]) -> Iterator[_Raw]:
    wanted, left = set(times.tolist()), len(times)
    for one in raw:
        if not left:
            return
        if one.time in wanted:
            left -= 1
            yield one


def _formats(capability: str) -> str:
    return " or ".join(kind.description for _, kind in sorted(LOG_FORMATS.items()) if getattr(kind, capability))
