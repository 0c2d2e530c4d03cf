"""Messages that wait in a process: a bounded number, of which the oldest give way."""

import threading
from collections import deque

from offpiste.transport.interface import Received
from offpiste.transport.tally import Tally


class Backlog:
    """Messages from the transport's thread for another one.

    Args:
        most: number of messages that may wait.
        dropped: counts those that gave way.
    """

    def __init__(self, most: int, dropped: Tally) -> None:
        self._most, self._dropped = most, dropped
        self._waiting: deque[Received] = deque()
        self._changed = threading.Condition()

    def put(self, received: Received) -> None:
        """Add a message."""
        with self._changed:
            self._waiting.append(received)
            if len(self._waiting) > self._most:
                self._dropped.add(f"{self._waiting.popleft().topic}: comes faster than it is decoded")
            self._changed.notify()

    def get(self, timeout: float) -> Received | None:
        """The oldest that waits; None where none has come within some time [s]."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(timeout)
            return self._waiting.popleft() if self._waiting else None
