"""What a log with cameras and LiDARs offers, whatever its format; `offpiste.logs.sensors` reads it through a rig."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from offpiste.logs.camera_model import CameraModel
from offpiste.logs.log import Log


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
        stamps: which clock counts (`offpiste.rig.Clock`).
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
        """A lens, and `camera_from_image` (`offpiste.logs.camera_model.model_from_message`).

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
