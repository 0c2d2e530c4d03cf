"""What all processes of a drive share: their rings, the clock, the vehicle's track, and a sign of life."""

import ctypes
import gc
import os
import struct
import time
from collections.abc import Callable, Collection, Mapping
from itertools import chain, count
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from offpiste.live.packing import packed, reading_from, unpacked
from offpiste.live.ring import Ring
from offpiste.live.session import Session
from offpiste.runtime.estimator import Given, Intake, VehicleTrack
from offpiste.transport.tally import Tally

BEAT: Final = 0.2
"""Time between two signs of life [s]."""
STAMP: Final = struct.Struct("<dd")
"""A stamp, and when it was heard by the steady clock [s]."""
RUNS_ON: Final = 1.0
"""The clock runs on for so long after the last new stamp [s]; then it stands still, and nothing is driven by it."""
Change = Literal["", "jumped", "went back"]
"""Why a map no longer fits: the pose jumped, or the clock went back; empty if it fits."""
BACK: Final = 0.1
"""The clock went back where a stamp is older than the newest by more [s]; else messages came in another order."""
GIVEN_BACK: Final = 10.0
"""Time between two times that freed memory is given back [s]."""
AFTER: Final = 8.0
"""Once the parent is gone, what stops the vehicle is looked after for so long [s]."""


def keep_loaded() -> None:
    """Keep what has been loaded out of garbage collection: to look through it all takes a quarter of a second."""
    gc.collect()
    gc.freeze()
    gc.collect()  # Python waits with the next until there is a quarter as much as the last one looked through


def free_file(path: Path) -> Path:
    """A file that is not there: where a process was killed, what it wrote is kept, and the next one has a number."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(one for one in chain((path,), numbered) if not one.exists())


class FreedMemory:
    """Freed memory, given back to the system now and then, where the C library is glibc.

    Maps grow, and the next one may not fit into the hole that the last one leaves. The process that plans grew by a
    gigabyte in half an hour; whether by such holes is not proven.
    """

    def __init__(self) -> None:
        self._trim, self._last = getattr(ctypes.CDLL(None), "malloc_trim", None), time.monotonic()

    def give_back(self) -> None:
        """Give it back, if the last time is long enough ago."""
        if self._trim is not None and time.monotonic() - self._last > GIVEN_BACK:
            self._trim(0)
            self._last = time.monotonic()


class Part:
    """A process of a drive.

    Attributes:
        dropped: number of messages that were dropped, by reason.
    """

    def __init__(self, name: str, session: Session) -> None:
        self.name, self.session, self.settings = name, session, session.settings
        self._rings: dict[str, Ring] = {}
        self._status, self._beat = session.ring(f"status-{name}"), -1.0
        self.dropped = Tally()
        self._started, self._orphaned_at = time.monotonic(), np.inf
        self._newest_stamp = self._latest_now = -np.inf

    def ring(self, name: str) -> Ring:
        """A ring of the session."""
        if name not in self._rings:
            self._rings[name] = self.session.ring(name)
        return self._rings[name]

    def hand_on(self, name: str, data: bytes) -> None:
        """Write to a ring; what is larger than its slots is dropped and counted."""
        if not self.ring(name).write(data):
            self.dropped.add(f"{name}: larger than the shared memory for it")

    @property
    def ending(self) -> bool:
        """Whether the drive ends, or the parent is gone: the vehicle is stopped."""
        return self.orphaned or self.ring("end").written > 0

    @property
    def ended(self) -> bool:
        """Whether the vehicle was stopped, so that nobody needs its readings any more."""
        return self.ring("end").written > 1 or (self.orphaned and time.monotonic() - self._orphaned_at > AFTER)

    @property
    def orphaned(self) -> bool:
        """Whether the parent is gone."""
        parent = parent_process()
        if parent is None or parent.is_alive():
            return False
        self._orphaned_at = min(self._orphaned_at, time.monotonic())
        return True

    def beat(self, state: str, numbers: Callable[[], Mapping[str, Any]] = dict, **values: Any) -> None:
        """Give a sign of life, with a state in words ("ready", or what it waits for) and numbers; not too often.

        Args:
            numbers: are asked for when a sign is due; for what takes time to count.
        """
        now = time.monotonic()
        if now - self._beat < BEAT:
            return
        self._beat = now
        about = {
            "state": state,
            "cpu_s": time.process_time(),
            "rss_mb": _resident(),
            "dropped": self.dropped.snapshot(),
        }
        about |= {"pid": os.getpid(), "up_s": now - self._started}
        if not self._status.write(packed(about | values | dict(numbers()))):
            self._status.write(packed(about))  # a sign of life, whatever there is to say

    def end_with(self, state: str) -> None:
        """Leave a last state."""
        self._beat = -1.0
        self.beat(state)

    def now(self) -> float:
        """Time of the robot [s]; minus infinity before it is known.

        It runs on between stamps; where one comes late, it waits for the stamps to come up to it.
        """
        if self.settings.clock == "system":
            return time.time()
        stamp, at = self._stamp()
        if stamp < self._newest_stamp - BACK:
            self._newest_stamp = self._latest_now = -np.inf
        self._newest_stamp = max(self._newest_stamp, stamp)
        self._latest_now = max(self._latest_now, stamp + min(time.monotonic() - at, RUNS_ON))
        return self._latest_now

    @property
    def clock_stands_still(self) -> bool:
        """Whether no new stamp of the robot's clock has come for so long that it says nothing about ages any more."""
        return self.settings.clock != "system" and time.monotonic() - self._stamp()[1] > RUNS_ON

    def _stamp(self) -> tuple[float, float]:
        """The newest stamp of the robot's clock, and when it was first heard by the steady clock [s]."""
        newest = self.ring("clock").newest()
        return (-np.inf, -np.inf) if newest is None else STAMP.unpack(newest.data)


class TrackFeed:
    """The vehicle's track, kept up to date from the ring of readings.

    Attributes:
        track: readings.
        given: what the vehicle was last given by whomever, as it says itself.
        came: when the last reading that was taken came, by the steady clock [s].
    """

    def __init__(self, part: Part, actuators: Collection[str]) -> None:
        timeouts = part.settings.runtime.timeouts
        self._part, self.track = part, VehicleTrack(slowest=timeouts.state, actuators=actuators)
        self.intake = Intake(self.track, actuators, timeouts, part.dropped)
        self._ring = part.ring("readings")
        self._number, self.given = self._ring.written, Given()
        self.came = -np.inf

    def update(self, now: float) -> Change:
        """Take what is new; why the map no longer fits."""
        changed: Change = ""
        if now < self.intake.now - BACK and self.intake.now < float("inf"):
            self.track.clear()
            changed = "went back"
        self.intake.now = now
        for entry in self._ring.since(self._number):
            self._number, values = entry.number, unpacked(entry.data)
            self.given = Given(values["control"], values.get("gear"))
            taken = self.intake.vehicle(reading_from(values))
            if taken != "dropped":
                self.came = values["came"]
            if taken == "jumped":
                changed = changed or taken
        return changed


def _resident() -> float:
    """Memory of this process [MB]."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - five times a second
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
