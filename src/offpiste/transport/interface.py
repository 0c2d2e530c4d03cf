"""What the rest needs of a transport: publish, subscribe, which topics there are, and what was refused.

Zenoh is behind it (`zenoh_transport`); a node of a DDS binding or of rclpy has the same five methods.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from offpiste.transport.tally import Tally


@dataclass(frozen=True)
class Received:
    """A message as it came, in CDR.

    Attributes:
        type: as `nav_msgs/msg/Odometry`; "" where neither the key nor the rig says it.
        received: by this computer's clock [s since 1970].
        sequence: number that its publisher gave it; -1 without one.
        publisher: identity of its publisher (GID); empty without one.
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
    """

    refused: Tally

    @property
    def identity(self) -> bytes:
        """What the identities of all our publishers begin with."""
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

    def decode(self, message: Received) -> Any:
        """The message of what was received; None, and counted as refused, where it cannot be decoded."""
        ...

    def close(self) -> None:
        """End the connection."""
        ...
