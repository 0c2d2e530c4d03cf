"""Interface of a transport: publish, subscribe, list topics, and count refused messages.

`zenoh_transport` implements it over zenoh; `ros2/offpiste_ros` has a node of rclpy with the same methods.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

from offpiste.transport.message_types import MessageTypes

MOST: Final = 64
"""Maximum number of reasons that a tally counts by name."""
OTHERS: Final = "other reasons"


class Tally(Counter[str]):
    """Number of messages by reason; after `MOST` reasons, new ones count as `OTHERS`.

    Several threads may `add`; readers take a `snapshot`.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        super().__init__()

    def __setitem__(self, reason: str, count: int) -> None:
        with self._lock:
            if reason not in self and len(self) >= MOST:
                count, reason = count + self[OTHERS], OTHERS
            super().__setitem__(reason, count)

    def add(self, reason: str, count: int = 1) -> None:
        """Count messages."""
        with self._lock:
            self[reason] += count

    def snapshot(self) -> dict[str, int]:
        """Return a copy of the counts above zero."""
        with self._lock:
            return {reason: count for reason, count in self.items() if count > 0}


@dataclass(frozen=True)
class Received:
    """A received message, serialised as CDR.

    Attributes:
        type: for example `nav_msgs/msg/Odometry`; "" if neither the key nor the rig states it.
        received: arrival by this computer's clock [s since 1970].
        sequence: number given by the publisher; -1 if missing.
        publisher: identity of the publisher (GID); empty if missing. If several publish and the transport cannot tell
            them apart, it differs from message to message.
        steady: arrival by the monotonic clock [s].
    """

    topic: str
    type: str
    data: bytes
    received: float
    sequence: int = -1
    publisher: bytes = b""
    steady: float = field(default_factory=time.monotonic)


Deliver = Callable[[Received], None]
"""Callback for each message of a topic. It runs in the transport's thread and must return at once."""
Publish = Callable[[Any], None]
"""Function that sends a message (of `offpiste.logs.ros.writer.make`)."""


@runtime_checkable
class Transport(Protocol):
    """Connection to a robot.

    Attributes:
        refused: number of messages that were not delivered, by topic and reason.
        types: known message types.
    """

    refused: Tally
    types: MessageTypes

    @property
    def identity(self) -> bytes:
        """Prefix of `Received.publisher` for messages from any process of this drive."""
        ...

    def publisher(self, topic: str, msgtype: str, *, keep: bool = False) -> Publish:
        """Return a function that publishes on a topic.

        Args:
            msgtype: for example `nav_msgs/msg/Path`.
            keep: send the last message to later subscribers (durability "transient local").

        Raises:
            TransportError: the type is unknown.
        """
        ...

    def subscribe(
        self, topic: str, deliver: Deliver, *, msgtype: str = "", history: bool = False, unchecked: bool = False
    ) -> None:
        """Deliver the messages of a topic in their order.

        Args:
            msgtype: the only type that is accepted; "" accepts every known type.
            history: also request the last message kept by each publisher.
            unchecked: deliver messages of any type, without their data, to detect other publishers.
        """
        ...

    def topics(self) -> dict[str, str]:
        """Return the topics published by others, with their types."""
        ...

    def routers(self) -> int:
        """Return the number of connected routers: 0 while the connection is lost, 1 if the transport has no router."""
        ...

    def decode(self, message: Received) -> Any:
        """Decode a message; return None and count it as refused if that fails."""
        ...

    def close(self) -> None:
        """Close the connection."""
        ...


@runtime_checkable
class RobotSettings(Protocol):
    """Settings of the connection to a robot. They can be pickled: each process of a drive connects by itself."""

    @property
    def says_types(self) -> bool:
        """Whether messages or publishers state the message type; otherwise the rig must."""
        ...

    def require(self) -> None:
        """Raise `MissingExtra` if a required package is not installed."""
        ...

    def connect(self, definitions: Sequence[Path] = ()) -> Transport:
        """Open a connection.

        Args:
            definitions: files of message types that rosbags lacks.

        Raises:
            TransportError: the robot does not answer, or a setting is wrong.
        """
        ...

    def hosted(self) -> AbstractContextManager["RobotSettings"]:
        """Return settings for all processes of a drive; a router started here outlives the calling process.

        Raises:
            TransportError: it cannot be started.
        """
        ...
