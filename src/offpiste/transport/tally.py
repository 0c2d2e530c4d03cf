"""Counts by reason that stay small, whatever comes from outside."""

import threading
from collections import Counter
from typing import Final

MOST: Final = 64
"""Number of reasons that are counted by name."""
OTHERS: Final = "other reasons"


class Tally(Counter[str]):
    """Number of messages by reason; once there are `MOST` reasons, those that are new count as `OTHERS`.

    Where several threads count, they `add`, and who reads takes a `snapshot`.
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
        """The counts now, of reasons that there were."""
        with self._lock:
            return {reason: count for reason, count in self.items() if count > 0}
