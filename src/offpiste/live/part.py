"""Common parts of the processes of a drive: rings, clock, vehicle track, course, and signs of life."""

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

from offpiste.live.ring import Ring, from_fields, packed, unpacked
from offpiste.live.session import Session
from offpiste.planning.course import Course, CourseTracker
from offpiste.runtime.estimator import Given, Intake, VehicleReading, VehicleTrack
from offpiste.transport.interface import Tally

BEAT: Final = 0.2
"""Time between signs of life [s]."""
STAMP: Final = struct.Struct("<dd")
"""Stamp, and its first arrival by the monotonic clock [s]."""
RUNS_ON: Final = 1.0
"""Time that the robot's clock continues after its last new stamp [s]; then it stands still and driving stops."""
Change = Literal["", "jumped", "went back"]
"""Event that invalidates a map: the pose jumped, or the clock went back; else empty."""
BACK: Final = 0.1
"""Difference between a stamp and the newest from which the clock went back [s]; smaller ones are reordering."""
GIVEN_BACK: Final = 10.0
"""Time between releases of freed memory [s]."""
AFTER: Final = 8.0
"""Time for which the vehicle is stopped and observed after the parent's end [s]."""
LOADING: Final = "loads its kernels"
"""State of a process that temporarily gives no sign of life."""


def freeze_loaded_objects() -> None:
    """Exclude loaded objects from garbage collection, which would take a quarter of a second."""
    gc.collect()
    gc.freeze()
    gc.collect()  # Python delays the next collection until a quarter as many objects as in this one are new


def unused_path(path: Path) -> Path:
    """Return the path, or the first numbered one that is free: files of a killed process are kept."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(one for one in chain((path,), numbered) if not one.exists())


class FreedMemory:
    """Regular release of freed memory to the system, if the C library is glibc.

    Without it, the planning process grew by a gigabyte in half an hour, possibly by fragmentation from growing maps.
    """

    def __init__(self) -> None:
        self._trim, self._last = getattr(ctypes.CDLL(None), "malloc_trim", None), time.monotonic()

    def give_back(self) -> None:
        """Release freed memory if the last release is `GIVEN_BACK` seconds ago."""
        if self._trim is not None and time.monotonic() - self._last > GIVEN_BACK:
            self._trim(0)
            self._last = time.monotonic()


class Part:
    """Process of a drive.

    Attributes:
        dropped: number of dropped messages, by reason.
    """

    def __init__(self, name: str, session: Session) -> None:
        self.name, self.session, self.settings = name, session, session.settings
        self._rings: dict[str, Ring] = {}
        self._status, self._beat = session.ring(f"status-{name}"), -1.0
        self.dropped = Tally()
        self._started, self._orphaned_at = time.monotonic(), np.inf
        self._newest_stamp = self._latest_now = -np.inf

    def ring(self, name: str) -> Ring:
        """Return a ring of the session."""
        if name not in self._rings:
            self._rings[name] = self.session.ring(name)
        return self._rings[name]

    def write(self, name: str, data: bytes) -> None:
        """Write to a ring; drop and count a message that is too large."""
        if not self.ring(name).write(data):
            self.dropped.add(f"{name}: larger than its shared memory")

    @property
    def last_command(self) -> dict[str, Any]:
        """Last command, possibly of an earlier process; empty if there is none."""
        newest = self.ring("commands").newest()
        return {} if newest is None else unpacked(newest.data)

    @property
    def ending(self) -> bool:
        """Whether the drive ends, or the parent has ended, so that the vehicle is being stopped."""
        return self.orphaned or self.ring("end").written > 0

    @property
    def ended(self) -> bool:
        """Whether the vehicle has been stopped and its readings are no longer needed."""
        return self.ring("end").written > 1 or (self.orphaned and time.monotonic() - self._orphaned_at > AFTER)

    @property
    def orphaned(self) -> bool:
        """Whether the parent has ended."""
        parent = parent_process()
        if parent is None or parent.is_alive():
            return False
        self._orphaned_at = min(self._orphaned_at, time.monotonic())
        return True

    def beat(self, state: str, numbers: Callable[[], Mapping[str, Any]] = dict, **values: Any) -> None:
        """Give a sign of life, at most every `BEAT` seconds.

        Args:
            state: "ready", or a description.
            numbers: further values, computed only when a sign is due.
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
            "pid": os.getpid(),
            "up_s": now - self._started,
        }
        if not self._status.write(packed(about | values | dict(numbers()))):
            self._status.write(packed(about))  # a sign of life, even if the other values are too large

    def report(self, state: str) -> None:
        """Write a last state."""
        self._beat = -1.0
        self.beat(state)

    def now(self) -> float:
        """Return the robot's time [s]; minus infinity while it is unknown.

        It continues between stamps, and waits for stamps that come late.
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
    def clock_stopped(self) -> bool:
        """Whether the robot's clock has had no new stamp for so long that ages by it are meaningless."""
        return self.settings.clock != "system" and time.monotonic() - self._stamp()[1] > RUNS_ON

    def _stamp(self) -> tuple[float, float]:
        """Return the newest stamp of the robot's clock, and its first arrival by the monotonic clock [s]."""
        newest = self.ring("clock").newest()
        return (-np.inf, -np.inf) if newest is None else STAMP.unpack(newest.data)


class TrackFeed:
    """The vehicle's track, updated from the ring of readings.

    Attributes:
        given: commands that the vehicle last reported.
        came: arrival of the last accepted reading by the monotonic clock [s].
    """

    def __init__(self, part: Part, actuators: Collection[str]) -> None:
        timeouts = part.settings.runtime.timeouts
        self._part, self.track = part, VehicleTrack(slowest=timeouts.state, actuators=actuators)
        self.intake = Intake(self.track, actuators, timeouts, part.dropped)
        self._ring = part.ring("readings")
        self._number, self.given = self._ring.written, Given()
        self.came = -np.inf

    def update(self, now: float) -> Change:
        """Take new readings; return the event that invalidates the map, if any."""
        changed: Change = ""
        if now < self.intake.now - BACK and self.intake.now < float("inf"):
            self.track.clear()
            changed = "went back"
        self.intake.now = now
        for entry in self._ring.since(self._number):
            self._number, values = entry.number, unpacked(entry.data)
            self.given = Given(values["control"], values.get("gear"))
            taken = self.intake.vehicle(from_fields(VehicleReading, values))
            if taken != "dropped":
                self.came = values["came"]
            if taken == "jumped":
                changed = changed or taken
        return changed


class NewestCourse:
    """The newest course of the session.

    Attributes:
        number: of the current course; 0 before the first.
    """

    def __init__(self, part: Part) -> None:
        self._part, self._ring, self.number = part, part.ring("course"), 0

    def changed(self) -> CourseTracker | None:
        """Return a tracker of a new course; it resumes at the last progress if that course was being driven."""
        newest = self._ring.newest()
        if newest is None or newest.number == self.number:
            return None
        self.number = newest.number
        tracker = CourseTracker(from_fields(Course, unpacked(newest.data)))
        before = self._part.last_command
        if before.get("course") == self.number:
            tracker.resume(before["progress"])
        return tracker


def _resident() -> float:
    """Return the memory of this process [MB]."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - five times a second
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
