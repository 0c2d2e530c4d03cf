"""Process that records received and sent messages as a log for `inspect`, `extract` and `live --replay`."""

import shutil
import time
from collections.abc import Collection
from contextlib import closing
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np

from offpiste.core.errors import LogError
from offpiste.live.part import Part, unused_path
from offpiste.live.receive import Backlog
from offpiste.live.reception import Reception
from offpiste.live.session import CLOCK, COMMAND, DIAGNOSTICS, MODE, PLAN, RecordSettings, Session
from offpiste.logs.ros.writer import McapWriter
from offpiste.logs.transforms import TRANSFORMS, frames
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.received import Received

_WAITING, _WAITING_SIZE = 10_000, 256 << 20
"""Maximum number and total size [bytes] of messages that wait for the disk."""
_LOOKS: Final = 0.2
"""Time between checks of the disk space and the file size [s]."""
_MOST, _SIZE = 256, 64 << 20
"""Maximum number and total size [bytes] of the messages repeated in each file; the oldest are left out."""
_OURS: Final = {
    COMMAND: "sensor_msgs/msg/Joy",
    MODE: "std_msgs/msg/String",
    PLAN: "nav_msgs/msg/Path",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
"""Topics published by offpiste with their types, which keys may lack."""


def refuse_full_disk(settings: RecordSettings) -> None:
    """Raise `LogError` if the disk has less free space than must remain."""
    if (free := shutil.disk_usage(settings.path.parent).free / 1e9) < settings.free:
        what = f"{free:.3g} GB of the disk are free, and {settings.free:g} GB have to stay free"
        raise LogError(what, where=settings.path, how="make room on the disk, or lower --record-free")


class Recording:
    """Write messages to numbered files, each readable by itself and of limited size and duration.

    Args:
        repeated: topics whose newest message begins each file; of transforms, one message per set of frames.

    Attributes:
        path: of the current file.
        messages: number of messages in all files.

    Raises:
        LogError: a file cannot be written.
    """

    def __init__(self, settings: RecordSettings, types: MessageTypes, repeated: Collection[str]) -> None:
        self._settings, self._types, self._repeated = settings, types, frozenset(repeated)
        self._definition = cache(types.definition)
        self._newest: dict[tuple[str, ...], Received] = {}
        self.messages, self._looked = 0, -np.inf
        self._began: int | None = None  # first stamp in the file [ns]
        self._open()

    def add(self, received: Received) -> None:
        """Write a message; repeated topics that arrive before the clock is known are written afterwards."""
        if np.isfinite(received.received):
            stamp = round(received.received * 1e9)
            if self._began is not None and abs(stamp - self._began) > self._settings.seconds * 1e9:
                self._next()
            if self._began is None:
                self._began = stamp
                for one in self._newest.values():
                    self._write(one, stamp)
            self._write(received, stamp)
        if received.topic in self._repeated:
            self._keep(received)

    def look(self) -> None:
        """Check disk space and file size, at most every `_LOOKS` seconds.

        Raises:
            LogError: disk space is insufficient.
        """
        if time.monotonic() - self._looked < _LOOKS:
            return
        self._looked = time.monotonic()
        refuse_full_disk(self._settings)
        if self._began is not None and self.path.stat().st_size > self._settings.size * 1e9:
            self._next()

    def close(self) -> None:
        """Close the current file."""
        self._writer.close()

    def _open(self) -> None:
        self._writer = McapWriter(unused_path(self._settings.path))
        self.path = self._writer.path
        self._began = None

    def _next(self) -> None:
        self.close()
        self._open()

    def _write(self, one: Received, stamp: int) -> None:
        self._writer.write_serialised(one.topic, one.type, one.data, self._definition(one.type), stamp)
        self.messages += 1

    def _keep(self, received: Received) -> None:
        key = [received.topic]
        if received.type in TRANSFORMS and (message := self._types.decoded(received.type, received.data)) is not None:
            key += [f"{parent} {child}" for parent, child in map(frames, message.transforms)]
        self._newest.pop(tuple(key), None)  # the order is that of arrival
        self._newest[tuple(key)] = received
        while len(self._newest) > _MOST or sum(len(one.data) for one in self._newest.values()) > _SIZE:
            del self._newest[next(iter(self._newest))]


def record(session: Session) -> None:
    """Run the process; insufficient disk space ends it alone."""
    part = Part("record", session)
    rig, settings, transport = part.rig, session.settings, part.connect()
    assert settings.record is not None
    reception = Reception(rig, settings.course, cameras=False)
    types = {output.topic: output.type for output in rig.outputs.values()} | _OURS
    topics = dict.fromkeys((*rig.topics, *types), False) | reception.topics
    topics |= {camera.info: True for camera in rig.cameras.values() if camera.info} | {MODE: True}
    if settings.clock == "clock":
        topics[CLOCK], types[CLOCK] = False, "rosgraph_msgs/msg/Clock"
    waiting = Backlog(_WAITING, part.dropped, size=_WAITING_SIZE, why="the disk is too slow")

    def deliver(received: Received) -> None:
        if settings.clock != "system":  # stamps are by the robot's clock, which steps a replay
            received = replace(received, received=part.now())
        if not np.isfinite(received.received) and not topics[received.topic]:
            part.dropped.add(f"{received.topic}: before the clock is known")
            return
        waiting.put(received)

    for topic, history in topics.items():
        msgtype = reception.type_of(topic) or types.get(topic, "")
        transport.subscribe(topic, deliver, msgtype=msgtype, history=history)
    repeated = [topic for topic, history in topics.items() if history]
    try:
        with closing(Recording(settings.record, transport.types, repeated)) as recording:
            while not part.ended:  # the stop at the end is recorded, too
                if (received := waiting.get(0.1)) is not None:
                    recording.add(received)
                recording.look()
                refused = transport.refused.snapshot()
                part.beat(f"records {recording.path}", messages=recording.messages, refused=refused)
    except LogError as error:
        part.report(str(error))
    transport.close()
