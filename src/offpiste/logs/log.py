"""Interface of recorded logs, the registry of formats, and `open_log`.

A format is a subclass of `Log` registered in `LOG_FORMATS`. `offpiste.logs.formats` holds those that ship;
`examples/extending/euroc.py` adds another one.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from offpiste.core.errors import LogError, SeveralLogs, TooLarge, did_you_mean
from offpiste.core.limits import packaged_table
from offpiste.core.object_store import refuse_url
from offpiste.core.registry import Registry
from offpiste.logs.transforms import Transform, listed
from offpiste.rig.camera import CameraModel
from offpiste.rig.channels import Clock, topic_in_words
from offpiste.rig.labels import without_comment

LOG_FORMATS: "Registry[type[Log]]" = Registry("log format", package="offpiste.logs.formats", error=LogError)
"""Log formats by name."""

JOINT_ARRAYS: Final = {"position": "", "velocity": "_vel", "effort": "_effort"}
"""Arrays of sensor_msgs/JointState, and the suffix of their entries' names in `Topic.joints`."""

_LISTED = 5
"""Largest number of logs of a folder in a message."""
_EXPORTED_BY: Final = packaged_table("offpiste.logs.formats", "tables.toml")["exporters"]
"""Exporters of unsupported formats, by file extension."""


@dataclass(frozen=True)
class Topic:
    """Description of a named stream of samples."""

    name: str
    type: str  # message type, or kind of file
    count: int  # number of samples; of a part (`part_of`), those at the beginning of the log only
    # Names of the numbers; empty if they depend on the first messages, of which there are none.
    fields: tuple[str, ...]
    units: Mapping[str, str] = field(default_factory=dict)  # of fields, if the log states them apart from the names
    joints: Mapping[str, str] = field(default_factory=dict)  # names of the entries of sensor_msgs/JointState, by field
    unread: Mapping[str, str] = field(default_factory=dict)  # reasons why other columns are not fields, by column
    part_of: str = ""  # for the transforms between two frames, the topic that holds them

    def in_words(self, name: str) -> str:
        """Return a field with the name of its joint: `position[1] (steering)`."""
        return f"{name} ({self.joints[name]})" if name in self.joints else name

    def joint_of(self, name: str) -> str:
        """Return the name of a field's joint, without the suffix of `JOINT_ARRAYS`."""
        return self.joints[name].removesuffix(JOINT_ARRAYS[name.partition("[")[0]]) if name in self.joints else ""

    def fields_here(self, fields: Sequence[str], joints: Sequence[str]) -> tuple[str, ...]:
        """Return a rig's fields as named in this log: array entries by joints, columns without comment signs."""
        if not joints or not self.joints:
            return tuple(name if name in self.fields else without_comment(name) for name in fields)
        own = {(one.partition("[")[0], self.joint_of(one)): one for one in reversed(list(self.joints))}
        wanted = [(one.partition("[")[0], joint) for one, joint in zip(fields, joints, strict=True)]
        if missing := [pair for pair in wanted if pair not in own]:
            known = ", ".join(dict.fromkeys(joint for array, joint in reversed(own) if array == missing[0][0]))
            what = f"topic '{self.name}' has no joint '{missing[0][1]}' in {missing[0][0]}"
            raise LogError(what, how=f"fix joints in the rig; available: {known or 'none'}")
        return tuple(own[pair] for pair in wanted)


@dataclass(frozen=True)
class Samples:
    """Recorded numbers in file order, neither sorted, cleaned nor converted."""

    time: Float[np.ndarray, " n"]  # stamps [s]
    values: Float[np.ndarray, "n k"]  # a column per field


@dataclass(frozen=True)
class RawImage:
    """Recorded image."""

    time: float  # stamp [s]
    frame: str  # optical frame of the camera
    pixels: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"] | None  # RGB of any bit depth; None if damaged


@dataclass(frozen=True)
class RawCloud:
    """Recorded point cloud."""

    time: float  # stamp [s]
    frame: str  # frame of the points
    points: np.ndarray  # records with x, y, z and other fields


class SetBack(NamedTuple):
    """Backward step of a clock."""

    time: float  # last stamp before the step [s]
    by: float  # size of the step [s]


Times = Float[np.ndarray, " n"]
"""Stamps of a topic [s]."""


class Log(ABC):
    """Recorded drive; `open_log` chooses the format.

    A format overrides `recognises`, `topics` and `_read`. A format with cameras or LiDARs sets `has_sensors` and
    overrides the methods that read them. Messages are read one at a time, so that memory does not grow with the log.
    """

    description: ClassVar[str] = ""  # name of the format in messages, e.g. "a KITTI raw drive"
    has_sensors: ClassVar[bool] = False  # the format can hold images or point clouds
    has_messages: ClassVar[bool] = False  # `messages` yields decoded ROS messages
    has_arrivals: ClassVar[bool] = False  # samples have arrival times, too; `stamps` chooses one of the two
    has_clock_unit: ClassVar[bool] = False  # the rig's clock states the unit of the stamps
    path: Path
    warnings: tuple[str, ...] = ()  # parts of a damaged or ambiguous log that the reader left out or guessed

    @staticmethod
    def recognises(path: Path) -> bool:
        """Return whether an existing file or folder has this format; must be quick."""
        return False

    @classmethod
    def open(cls, path: Path, clock: Clock) -> "Log":
        """Open a log of this format; those without `has_clock_unit` ignore the rig's `clock`."""
        return cls(path, clock=clock) if cls.has_clock_unit else cls(path)  # type: ignore[call-arg]

    @property
    @abstractmethod
    def topics(self) -> dict[str, Topic]:
        """Topics by name."""

    @property
    def set_back(self) -> SetBack | None:
        """Backward step of the recorder's clock, after which arrival times no longer give the order of messages."""
        return None

    @property
    def clock(self) -> Clock:
        """Clock of the stamps: for a table, the time column in use and its unit."""
        return Clock()

    @abstractmethod
    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples: ...

    def read(self, topic: str, fields: Sequence[str], *, stamps: str = "header") -> Samples:
        """Read some fields of a topic.

        Args:
            topic: name in `topics`.
            fields: names in the topic's `fields`.
            stamps: "header" (a message's own stamp if it has one) or "receive"; ignored without `has_arrivals`.

        Raises:
            LogError: the topic or field is missing, the topic is empty, or the file is damaged there.
        """
        result = self._find(topic)
        if result.count == 0:
            what, how = f"{topic_in_words(topic)} is empty", "declare its channels absent in the rig"
            raise LogError(what, where=self.path, how=how)
        if missing := [f for f in fields if f not in result.fields]:
            what = f"{topic_in_words(topic)} ({result.type}) has no field '{missing[0]}'"
            what = result.unread.get(missing[0], what)
            how = f"available: {', '.join(result.fields[:40]) or 'no numeric field'}"
            raise LogError(what, where=self.path, how=how)
        return self._read(result, fields, stamps)

    def stamps(self, topic: str, *, stamps: str = "header") -> Float[np.ndarray, " n"]:
        """Return the stamps of all messages of a topic in file order [s], decoding as little as possible."""
        return self.read(topic, self._find(topic).fields[:1], stamps=stamps).time

    def messages(self, topic: str, *, stamps: str = "header") -> Iterator[tuple[float, Any]]:
        """Yield the stamp [s] and the decoded ROS message of each message of a topic, in file order."""
        raise LogError("this format holds no messages", where=self.path, how=f"give {_formats('has_messages')}")

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Return the fixed transforms between frames.

        Args:
            topics: topics with transforms (`frames.topics` of the rig); ignored by formats that know where they are.
        """
        return []

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Return the calibration of a camera, and `camera_from_image` (`offpiste.rig.camera.model_from_message`)."""
        raise self.no_sensors()

    def frame(self, topic: str) -> str:
        """Return the frame of a topic's first message."""
        raise self.no_sensors()

    def images(self, topic: str, *, stamps: str = "header", times: Times | None = None) -> Iterator[RawImage]:
        """Yield the images of a topic in file order, or those with some of its stamps; only these are decoded."""
        raise self.no_sensors()

    def clouds(self, topic: str, *, stamps: str = "header", times: Times | None = None) -> Iterator[RawCloud]:
        """Yield the point clouds of a topic (see `images`)."""
        raise self.no_sensors()

    def no_sensors(self) -> LogError:
        """Return the error for a format without images and clouds."""
        how = f"give {_formats('has_sensors')}"
        return LogError("this format holds no images or clouds", where=self.path, how=how)

    def _find(self, topic: str) -> Topic:
        result = self.topics.get(topic)
        if result is None:
            known = ", ".join(listed(sorted(self.topics))) or "none"
            how = f"{did_you_mean(topic, self.topics)}available: {known}"
            raise LogError(f"no topic '{topic}'", where=self.path, how=how)
        return result


def open_log(path: str | Path, *, clock: Clock | None = None) -> Log:
    """Open a recorded drive of any registered format.

    Args:
        path: file or folder.
        clock: time column of a table and its unit; guessed by default.

    Raises:
        SeveralLogs: a folder of logs.
        LogError: the path does not exist, its format is unknown, or it cannot be read.
    """
    refuse_url(path)
    path = Path(path)
    if not path.exists():
        raise LogError("no such file or folder", where=path)
    formats = [kind for _, kind in sorted(LOG_FORMATS.items())]
    # Formats from outside come first, and bags last: a folder of another format may hold a bag as well.
    shipped = [kind for kind in formats if kind.__module__.startswith("offpiste.")]
    for kind in (*(kind for kind in formats if kind not in shipped), *reversed(shipped)):
        if kind.recognises(path):
            return kind.open(path, clock or Clock())
    logs, others = contents_of(path) if path.is_dir() else ([], [])
    if logs:
        more = f" and {len(logs) - _LISTED} more" if len(logs) > _LISTED else ""
        what = f"a folder of logs: {', '.join(logs[:_LISTED])}{more}"
        how = f"give one of them, or inspect all: offpiste inspect {quote(str(path))}"
        raise SeveralLogs(what, where=path, how=how, logs=logs, others=others)
    how = f"give {', '.join(kind.description for kind in formats)}"
    if by := _EXPORTED_BY.get(path.suffix.lower()):
        how = f"export it by {by}"
    raise LogError("no known log format", where=path, how=how)


def contents_of(folder: Path) -> tuple[list[str], list[str]]:
    """Return the names of the logs directly in a folder, and of all other entries that are not hidden."""
    formats = [kind for _, kind in LOG_FORMATS.items()]
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    logs = [name for name in names if any(kind.recognises(folder / name) for kind in formats)]
    return logs, [name for name in names if name not in logs]


@contextmanager
def as_log_error(path: Path, what: str, how: str) -> Iterator[None]:
    """Turn errors of libraries, which let through those of struct, lz4, SQLite and others, into one line."""
    try:
        yield
    except TooLarge as error:
        raise TooLarge(error.what, where=error.where or path, how=error.how) from error
    except LogError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise LogError(f"{what}: {reason}", where=path, how=how) from error


def _formats(capability: str) -> str:
    return " or ".join(kind.description for _, kind in sorted(LOG_FORMATS.items()) if getattr(kind, capability))
