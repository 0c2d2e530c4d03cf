"""What the rest needs of a transport: publish, subscribe, which topics there are, and what was refused.

Zenoh is behind it (`zenoh_transport`); `ros2/offpiste_ros` has a node of rclpy with the same methods.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from offpiste.transport.message_types import MessageTypes
from offpiste.transport.tally import Tally


@dataclass(frozen=True)
class Received:
    """A message as it came, in CDR.

    Attributes:
        type: as `nav_msgs/msg/Odometry`; "" where neither the key nor the rig says it.
        received: by this computer's clock [s since 1970].
        sequence: number that its publisher gave it; -1 without one.
        publisher: identity of its publisher (GID); empty without one. Where several publish and the transport cannot
            tell them apart, it differs from message to message.
        steady: when it came, by the steady clock, which nobody sets [s].
    """

    topic: str
    type: str
    data: bytes
    received: float
    sequence: int = -1
    publisher: bytes = b""
    steady: float = field(default_factory=time.monotonic)


Deliver = Callable[[Received], None]
"""Is given each message of a topic, in the transport's own thread: it must return at once."""
Publish = Callable[[Any], None]
"""Sends a message (of `offpiste.logs.ros.writer.make`)."""


@runtime_checkable
class Transport(Protocol):
    """Connection to a robot.

    Attributes:
        refused: number of messages that were not delivered, by topic and reason.
        types: message types that are known.
    """

    refused: Tally
    types: MessageTypes

    @property
    def identity(self) -> bytes:
        """What `Received.publisher` begins with where a process of this drive has published the message."""
        ...

    def publisher(self, topic: str, msgtype: str, *, keep: bool = False) -> Publish:
        """Function that publishes on a topic.

        Args:
            msgtype: as `nav_msgs/msg/Path`.
            keep: those who subscribe later are sent the last message (durability "transient local").

        Raises:
            TransportError: the type is not known.
        """
        ...

    def subscribe(
        self, topic: str, deliver: Deliver, *, msgtype: str = "", history: bool = False, unchecked: bool = False
    ) -> None:
        """Have the messages of a topic delivered, in their order.

        Args:
            msgtype: messages of other types are refused; "" takes every known type.
            history: ask publishers for the last message that they keep.
            unchecked: deliver whatever is published there, of any type, without its data: who looks for other
                publishers wants to hear all of them.
        """
        ...

    def topics(self) -> dict[str, str]:
        """Topics that others publish, with their types."""
        ...

    def routers(self) -> int:
        """Number of routers it is connected to, 0 while the connection is lost; 1 where there is none to lose."""
        ...

    def decode(self, message: Received) -> Any:
        """The message of what was received; None, and counted as refused, where it cannot be decoded."""
        ...

    def close(self) -> None:
        """End the connection."""
        ...


@runtime_checkable
class RobotSettings(Protocol):
    """How a robot is reached. Each process of a drive is sent them, and connects by itself: they can be pickled."""

    @property
    def says_types(self) -> bool:
        """Whether a message's type comes with it, or with its publisher; else the rig has to say it."""
        ...

    def require(self) -> None:
        """Check that what it needs is installed.

        Raises:
            MissingExtra: it is not.
        """
        ...

    def connect(self, definitions: Sequence[Path] = ()) -> Transport:
        """A new connection.

        Args:
            definitions: files of message types that rosbags does not know.

        Raises:
            TransportError: nobody answers, or a setting is wrong.
        """
        ...

    def hosted(self) -> AbstractContextManager["RobotSettings"]:
        """Settings of all processes of a drive; what they connect through outlives the one that enters this.

        Raises:
            TransportError: it cannot be started.
        """
        ...
