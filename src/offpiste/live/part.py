"""What all processes of a drive share: their rings, the clock, the vehicle's track, and a sign of life."""

import os
import signal
import struct
import time
from collections import Counter
from collections.abc import Collection
from multiprocessing import parent_process
from typing import Any, Final

from offpiste.live.packing import packed, reading_from, unpacked
from offpiste.live.ring import Ring
from offpiste.live.session import Session
from offpiste.runtime.estimator import VehicleTrack
from offpiste.runtime.intake import Intake

BEAT: Final = 0.2
"""Time between two signs of life [s]."""
STAMP: Final = struct.Struct("<dd")
"""A stamp, and when it was heard by the steady clock [s]."""
_RUNS_ON: Final = 1.0
"""The clock runs on for so long after the last stamp [s]."""


class Part:
    """A process of a drive.

    Attributes:
        dropped: number of messages that were dropped, by reason.
    """

    def __init__(self, name: str, session: Session) -> None:
        self.name, self.session, self.settings = name, session, session.settings
        self._rings: dict[str, Ring] = {}
        self._status, self._beat = session.ring(f"status-{name}"), -1.0
        self.dropped: Counter[str] = Counter()
        self._started = time.monotonic()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends us

    def ring(self, name: str) -> Ring:
        """A ring of the session."""
        if name not in self._rings:
            self._rings[name] = self.session.ring(name)
        return self._rings[name]

    @property
    def ending(self) -> bool:
        """Whether the drive ends, or the parent is gone."""
        return self.orphaned or self.ring("end").written > 0

    @property
    def orphaned(self) -> bool:
        """Whether the parent is gone."""
        parent = parent_process()
        return parent is not None and not parent.is_alive()

    def beat(self, state: str, **values: Any) -> None:
        """Give a sign of life, with a state in words ("ready", or what it waits for) and numbers; not too often."""
        now = time.monotonic()
        if now - self._beat < BEAT:
            return
        self._beat = now
        about = {"state": state, "cpu_s": time.process_time(), "rss_mb": _resident(), "dropped": dict(+self.dropped)}
        self._status.write(packed(about | {"pid": os.getpid(), "up_s": now - self._started} | values))

    def end_with(self, state: str) -> None:
        """Leave a last state."""
        self._beat = -1.0
        self.beat(state)

    def now(self) -> float:
        """Time of the robot [s]; minus infinity before it is known."""
        if self.settings.clock == "system":
            return time.time()
        newest = self.ring("clock").newest()
        if newest is None:
            return float("-inf")
        stamp, at = STAMP.unpack(newest.data)
        return float(stamp + min(time.monotonic() - at, _RUNS_ON))


class TrackFeed:
    """The vehicle's track, kept up to date from the ring of readings.

    Attributes:
        track: readings.
        control: throttle, brake, steer that the vehicle was last given by whomever, as it says itself; None if not.
    """

    def __init__(self, part: Part, actuators: Collection[str]) -> None:
        self._part, self.track = part, VehicleTrack()
        self.intake = Intake(self.track, actuators, part.settings.runtime.timeouts, part.dropped)
        self._ring = part.ring("readings")
        self._number, self.control = self._ring.written, None

    def update(self, now: float) -> bool:
        """Take what is new; whether the map no longer fits: the pose jumped, or the clock went back."""
        changed = now < self.intake.now - 0.1 and self.intake.now < float("inf")
        if changed:
            self.track.clear()
        self.intake.now = now
        for entry in self._ring.since(self._number):
            self._number, values = entry.number, unpacked(entry.data)
            self.control = values["control"]
            changed |= self.intake.vehicle(reading_from(values)) == "jumped"
        return changed


def _resident() -> float:
    """Memory of this process [MB]."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - five times a second
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
