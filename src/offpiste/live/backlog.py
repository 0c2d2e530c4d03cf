"""Messages that wait in a process: a bounded number and size, shared fairly by their topics."""

import threading
from collections import Counter, deque
from collections.abc import Collection
from itertools import count

from offpiste.transport.interface import Received
from offpiste.transport.tally import Tally


class Backlog:
    """Messages from the transport's thread for another one.

    Where too many wait, the topic that takes the most room loses its oldest message: a topic keeps its only message,
    whatever comes on others.

    Args:
        most: number of messages that may wait.
        dropped: counts dropped messages by topic.
        size: of all messages that may wait [bytes].
        why: reason for dropping messages, in words.
    """

    def __init__(
        self, most: int, dropped: Tally, *, size: int = 1 << 62, why: str = "comes faster than it is decoded"
    ) -> None:
        self._most, self._size, self._dropped, self._why = most, size, dropped, why
        self._waiting: dict[str, deque[tuple[int, Received]]] = {}  # with a number in the order of arrival
        self._bytes, self._numbers = Counter[str](), count()
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def put(self, received: Received) -> None:
        """Add a message."""
        with self._changed:
            self._waiting.setdefault(received.topic, deque()).append((next(self._numbers), received))
            self._bytes[received.topic] += len(received.data)
            while (many := len(self) > self._most) or self._bytes.total() > self._size:
                room = {topic: len(of) if many else self._bytes[topic] for topic, of in self._waiting.items()}
                fullest = max(room, key=lambda topic: (len(self._waiting[topic]) > 1, room[topic]))
                self._dropped.add(f"{self._taken(fullest).topic}: {self._why}")
            self._changed.notify()

    def get(self, timeout: float) -> Received | None:
        """The oldest message; None where none has come within some time [s]."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(timeout)
            if not self._waiting:
                return None
            return self._taken(min(self._waiting, key=lambda topic: self._waiting[topic][0][0]))

    def _taken(self, topic: str) -> Received:
        _, received = self._waiting[topic].popleft()
        self._bytes[topic] -= len(received.data)
        if not self._waiting[topic]:
            del self._waiting[topic], self._bytes[topic]
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
