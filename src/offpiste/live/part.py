"""Common parts of the processes of a drive: rings, clock, vehicle track, course, and signs of life."""

import ctypes
import gc
import os
import struct
import time
from collections.abc import Callable, Collection, Mapping
from functools import cache, cached_property
from itertools import count
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from offpiste.live.ring import Reader, from_fields, packed, unpacked
from offpiste.live.session import Session
from offpiste.planning.course import Course, CourseTracker
from offpiste.rig.rig import Rig, load_rig
from offpiste.runtime.estimator import Given, Intake, VehicleReading, VehicleTrack
from offpiste.transport.received import Tally
from offpiste.transport.zenoh_transport import ZenohTransport

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
AFTER: Final = 8.0
"""Time for which the vehicle is stopped and observed after the parent's end [s]."""
LOADING: Final = "loads its kernels"
"""State of a process that temporarily gives no sign of life."""


def freeze_loaded_objects() -> None:
    """Exclude loaded objects from garbage collection, which would take a quarter of a second."""
    gc.collect()
    gc.freeze()
    gc.collect()  # Python delays the next collection until a quarter as many objects as in this one are new


def release_freed_memory() -> None:
    """Return freed memory to the system, if libc is glibc; without it, planning grows by 1 GB in half an hour."""
    if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(0)


def unused_path(path: Path) -> Path:
    """Return the path, or the first numbered one that is free: files of a killed process are kept."""
    if not path.exists():
        return path
    return next(one for n in count(2) if not (one := path.with_stem(f"{path.stem}-{n}")).exists())


class Part:
    """Process of a drive.

    Attributes:
        dropped: number of dropped messages, by reason.
    """

    def __init__(self, name: str, session: Session) -> None:
        self.name, self.session, self.settings = name, session, session.settings
        self.ring = cache(session.ring)
        self._status, self._beat = session.ring(f"status-{name}"), -1.0
        self.dropped = Tally()
        self._started, self._orphaned_at = time.monotonic(), np.inf
        self._newest_stamp = self._latest_now = -np.inf

    @cached_property
    def rig(self) -> Rig:
        """The vehicle's rig."""
        return load_rig(self.settings.rig)

    def connect(self) -> ZenohTransport:
        """Open a connection to the robot."""
        return ZenohTransport(self.settings.robot, self.rig.live.definitions)

    def reader(self, name: str, *, all_messages: bool = False) -> Reader:
        """Return a reader of a ring: of later messages, or also of those already written."""
        return Reader(self.ring(name), 0 if all_messages else None)

    def write(self, name: str, data: bytes) -> None:
        """Write to a ring; drop and count a message that is too large."""
        if not self.ring(name).write(data):
            self.dropped.add(f"{name}: larger than its shared memory")

    def newest(self, name: str) -> dict[str, Any]:
        """Return the values of a ring's last message, possibly of an earlier process; empty if there is none."""
        entry = self.ring(name).newest()
        return {} if entry is None else unpacked(entry.data)

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
            "rss_mb": _resident_memory(),
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
        self.track = VehicleTrack(slowest=timeouts.state, actuators=actuators)
        self.intake = Intake(self.track, actuators, timeouts, part.dropped)
        self._readings, self.given, self.came = part.reader("readings"), Given(), -np.inf

    def update(self, now: float) -> Change:
        """Take new readings; return the event that invalidates the map, if any."""
        changed: Change = ""
        if now < self.intake.now - BACK and self.intake.now < float("inf"):
            self.track.clear()
            changed = "went back"
        self.intake.now = now
        for values in self._readings.new():
            self.given = Given(values["control"], values.get("gear"))
            taken = self.intake.vehicle(from_fields(VehicleReading, values))
            if taken != "dropped":
                self.came = values["came"]
            if taken == "jumped":
                changed = changed or taken
        return changed


class NewestCourse:
    """The newest course of the session."""

    def __init__(self, part: Part) -> None:
        self._part, self._courses = part, part.reader("course", all_messages=True)

    @property
    def number(self) -> int:
        """Number of the current course; 0 before the first."""
        return self._courses.number

    def changed(self) -> CourseTracker | None:
        """Return a tracker of a new course; it resumes at the last progress if that course was being driven."""
        if (values := self._courses.newest()) is None:
            return None
        tracker, before = CourseTracker(from_fields(Course, values)), self._part.newest("commands")
        if before.get("course") == self.number:
            tracker.resume(before["progress"])
        return tracker


def _resident_memory() -> float:
    """Return the memory of this process [MB]."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - five times a second
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
