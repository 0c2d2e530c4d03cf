"""Counts by reason that stay small, whatever comes from outside."""

from collections import Counter
from typing import Final

MOST: Final = 64
"""Number of reasons that are counted by name."""
OTHERS: Final = "other reasons"


class Tally(Counter[str]):
    """Number of messages by reason; once there are `MOST` reasons, those that are new count as `OTHERS`."""

    def __setitem__(self, reason: str, count: int) -> None:
        if reason not in self and len(self) >= MOST:
            count, reason = count + self[OTHERS], OTHERS
        super().__setitem__(reason, count)
