"""Messages that wait in a process: a bounded number and size, of which the oldest give way."""

import threading
from collections import deque

from offpiste.transport.interface import Received
from offpiste.transport.tally import Tally


class Backlog:
    """Messages from the transport's thread for another one.

    Args:
        most: number of messages that may wait.
        dropped: counts those that gave way.
        size: of all that may wait [bytes].
        why: they gave way.
    """

    def __init__(
        self, most: int, dropped: Tally, *, size: int = 1 << 62, why: str = "comes faster than it is decoded"
    ) -> None:
        self._most, self._size, self._dropped, self._why = most, size, dropped, why
        self._held = 0
        self._waiting: deque[Received] = deque()
        self._changed = threading.Condition()

    def put(self, received: Received) -> None:
        """Add a message."""
        with self._changed:
            self._waiting.append(received)
            self._held += len(received.data)
            while len(self._waiting) > self._most or self._held > self._size:
                self._dropped.add(f"{self._taken().topic}: {self._why}")
            self._changed.notify()

    def get(self, timeout: float) -> Received | None:
        """The oldest that waits; None where none has come within some time [s]."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(timeout)
            return self._taken() if self._waiting else None

    def _taken(self) -> Received:
        received = self._waiting.popleft()
        self._held -= len(received.data)
        return received
