"""The clock that stamps are compared with: the computer's, the one on /clock, or the messages' own stamps."""

import time
from typing import Literal

Source = Literal["system", "clock", "stamps"]


class Clock:
    """Time of the robot [s].

    Between two messages it runs on with the computer's steady clock. It never goes back by itself, but it follows a
    source that does: a log that begins anew.

    Args:
        source: "system" (the robot's computers are synchronised with this one), "clock" (/clock), or "stamps" of the
            vehicle's readings.
        largest: it does not run on for longer than this after the last message of its source [s].
    """

    def __init__(self, source: Source, *, largest: float = 1.0) -> None:
        self.source, self._largest = source, largest
        self._stamp, self._at = float("-inf"), 0.0

    def heard(self, stamp: float) -> None:
        """A stamp of the source [s]."""
        at = time.monotonic()
        if self.source == "stamps" and self._stamp > stamp > self._stamp - 1.0:
            return  # late, not back
        self._stamp, self._at = stamp, at

    def now(self) -> float:
        """Time [s]; minus infinity before the source was heard."""
        if self.source == "system":
            return time.time()
        return self._stamp + min(time.monotonic() - self._at, self._largest)
