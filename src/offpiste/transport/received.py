"""Received messages, and counts of the refused ones."""

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

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
    """A received message, serialised as CDR; without type and data it is the sign of a publisher."""

    topic: str
    type: str  # for example `nav_msgs/msg/Odometry`
    data: bytes
    received: float  # arrival by this computer's clock [s since 1970]
    sequence: int = -1  # given by the publisher; -1 if missing
    publisher: bytes = b""  # identity of the publisher (GID); empty if missing
    steady: float = field(default_factory=time.monotonic)  # arrival by the monotonic clock [s]


Deliver = Callable[[Received], None]
"""Callback for each message of a topic. It runs in the transport's thread and must return at once."""
Publish = Callable[[Any], None]
"""Function that sends a message (of `offpiste.logs.ros.writer.make`)."""
