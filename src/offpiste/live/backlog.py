"""Messages that wait in a process: a bounded number and size, of which the oldest give way."""

import threading
from collections import deque
from collections.abc import Collection
from typing import Final

from offpiste.transport.interface import Received
from offpiste.transport.tally import Tally

LATCHED: Final = 16
"""Messages of a latched topic that may wait: each publisher of `/tf_static` sends its own."""


class Backlog:
    """Messages from the transport's thread for another one.

    Args:
        most: number of messages that may wait.
        dropped: counts those that gave way.
        size: of all that may wait [bytes].
        why: they gave way.
        latched: topics that are published once or rarely; their newest messages wait apart, so that others never
            drop them.
    """

    def __init__(
        self,
        most: int,
        dropped: Tally,
        *,
        size: int = 1 << 62,
        why: str = "comes faster than it is decoded",
        latched: Collection[str] = (),
    ) -> None:
        self._most, self._size, self._dropped, self._why = most, size, dropped, why
        self._held = 0
        self._waiting: deque[Received] = deque()
        self._latched = {topic: deque[Received](maxlen=LATCHED) for topic in latched}
        self._changed = threading.Condition()

    def put(self, received: Received) -> None:
        """Add a message."""
        with self._changed:
            if (apart := self._latched.get(received.topic)) is not None:
                apart.append(received)
                self._changed.notify()
                return
            self._waiting.append(received)
            self._held += len(received.data)
            while len(self._waiting) > self._most or self._held > self._size:
                self._dropped.add(f"{self._taken().topic}: {self._why}")
            self._changed.notify()

    def get(self, timeout: float) -> Received | None:
        """The oldest that waits, those of latched topics first; None where none has come within some time [s]."""
        with self._changed:
            if not (self._waiting or any(self._latched.values())):
                self._changed.wait(timeout)
            for apart in self._latched.values():
                if apart:
                    return apart.popleft()
            return self._taken() if self._waiting else None

    def _taken(self) -> Received:
        received = self._waiting.popleft()
        self._held -= len(received.data)
        return received


class Batch:
    """Messages until the next step, in their order: all but of large topics, of which the newest are kept.

    Args:
        large: topics that are bounded.
        size: of what is kept of each of them [bytes]; its newest message is kept in any case.
    """

    def __init__(self, large: Collection[str], size: int) -> None:
        self._size, self._count = size, 0
        self._messages: dict[int, Received] = {}
        self._large = {topic: deque[int]() for topic in large}

    def __len__(self) -> int:
        return len(self._messages)

    def add(self, received: Received) -> None:
        """Add a message."""
        self._messages[self._count] = received
        if (numbers := self._large.get(received.topic)) is not None:
            numbers.append(self._count)
            while len(numbers) > 1 and sum(len(self._messages[number].data) for number in numbers) > self._size:
                del self._messages[numbers.popleft()]
        self._count += 1

    def taken(self) -> list[Received]:
        """All that are kept, which are forgotten."""
        messages, self._messages = list(self._messages.values()), {}
        for numbers in self._large.values():
            numbers.clear()
        return messages
