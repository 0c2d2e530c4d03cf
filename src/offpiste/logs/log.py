"""What a recorded log is to the rest: topics with numeric fields, each sample with its stamp.

What a log with cameras and LiDARs offers, whatever its format; `offpiste.logs.sensor_log` reads it through a rig.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from offpiste.errors import LogError
from offpiste.rig.camera import CameraModel


@dataclass(frozen=True)
class Topic:
    """What a log holds under one name, known before its samples are read.

    Attributes:
        type: message type, or the kind of file.
        count: number of samples.
        fields: names of the numeric fields; empty where they are known only from a message, and there is none.
    """

    name: str
    type: str
    count: int
    fields: tuple[str, ...]


@dataclass(frozen=True)
class Samples:
    """Numbers as recorded, in the order of the file; nothing is sorted, dropped or converted yet.

    Attributes:
        time: stamps [s].
        values: one column a field.
    """

    time: Float[np.ndarray, " n"]
    values: Float[np.ndarray, "n k"]


class Log(ABC):
    """A recorded drive in any format. Readers are final; `offpiste.logs.open_log` chooses one.

    Attributes:
        warnings: what a damaged or ambiguous log made the reader leave out or guess, in words.
    """

    path: Path
    warnings: tuple[str, ...] = ()

    @property
    @abstractmethod
    def topics(self) -> dict[str, Topic]:
        """Topics by name."""

    @abstractmethod
    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples: ...

    def read(self, topic: str, fields: Sequence[str], *, stamps: str = "header") -> Samples:
        """Samples of some fields of a topic.

        Args:
            topic: name in `topics`.
            fields: names in the topic's `fields`.
            stamps: "header" (a message's own stamp where it has one) or "receive"; readers without the two ignore it.

        Raises:
            LogError: no such topic or field, no sample in it, or the file is damaged there.
        """
        found = self._found(topic)
        if found.count == 0:
            raise LogError(f"topic '{topic}' is empty", where=self.path, how="declare its channels absent in the rig")
        missing = [f for f in fields if f not in found.fields]
        if missing:
            raise LogError(
                f"topic '{topic}' ({found.type}) has no field '{missing[0]}'",
                where=self.path,
                how=f"it has: {', '.join(found.fields[:40]) or 'no numeric field'}",
            )
        return self._read(found, fields, stamps)

    def _found(self, topic: str) -> Topic:
        found = self.topics.get(topic)
        if found is None:
            known = ", ".join(sorted(self.topics)) or "none"
            raise LogError(f"no topic '{topic}'", where=self.path, how=f"it has: {known}")
        return found


@dataclass(frozen=True)
class Transform:
    """`parent_from_child`, fixed."""

    parent: str
    child: str
    matrix: Float[np.ndarray, "4 4"]


@dataclass(frozen=True)
class RawImage:
    """An image as recorded.

    Attributes:
        time: stamp [s].
        frame: in which it was taken.
        pixels: RGB; None where it cannot be decoded.
    """

    time: float
    frame: str
    pixels: UInt8[np.ndarray, "h w 3"] | None


@dataclass(frozen=True)
class RawCloud:
    """A cloud as recorded.

    Attributes:
        time: stamp [s].
        frame: of the points.
        points: records with x, y, z and more.
    """

    time: float
    frame: str
    points: np.ndarray


class SensorSource(ABC):
    """Cameras and LiDARs of one log. One entry a topic; streams hold one message at a time.

    Args:
        stamps: which clock counts (`offpiste.rig.rig.Clock`).
    """

    log: Log

    @abstractmethod
    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Fixed transforms between frames; none where the log has none.

        Raises:
            LogError: the log is damaged there.
        """

    @abstractmethod
    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """A lens, and `camera_from_image` (`offpiste.rig.camera.model_from_message`).

        Raises:
            LogError: no calibration there, or one that is not read.
        """

    @abstractmethod
    def frame(self, topic: str) -> str:
        """The frame that a topic's first message names.

        Raises:
            LogError: there is no message.
        """

    @abstractmethod
    def stamps(self, topic: str) -> Float[np.ndarray, " n"]:
        """Stamps of all messages [s], in the order of the file, without decoding them."""

    @abstractmethod
    def arrivals(self, topic: str) -> Float[np.ndarray, " n"] | None:
        """When each message was recorded [s], by one clock for all topics; None where stamps are all there is."""

    @abstractmethod
    def images(self, topic: str) -> Iterator[RawImage]:
        """Images in the order of the file.

        Raises:
            LogError: the topic holds something else.
        """

    @abstractmethod
    def clouds(self, topic: str) -> Iterator[RawCloud]:
        """Clouds in the order of the file.

        Raises:
            LogError: the topic holds something else.
        """
