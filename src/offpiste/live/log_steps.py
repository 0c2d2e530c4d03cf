"""A recorded drive in steps of the clock: what came until when, and what the run time would have commanded."""

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.interfaces import ConnectionExtRosbag2

from offpiste.core.conventions import DT
from offpiste.core.errors import LogError
from offpiste.live.driver import Heard, Step, StepDriver
from offpiste.logs.ros.bag_files import open_readers, reported, whole_messages
from offpiste.logs.ros.mcap_recovery import StreamedMcap
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.rig.channels import SECONDS_PER_UNIT
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import LidarSource
from offpiste.transport.message_types import MessageTypes

_LATEST: Final = 1.0
"""Longest revolution of a LiDAR [s]: a message waits no longer for its last point."""


@dataclass(frozen=True)
class Recorded:
    """A message of a log.

    Attributes:
        time: when it is played [ns].
        data: in CDR.
    """

    time: int
    topic: str
    type: str
    data: bytes


@dataclass(frozen=True)
class LogStep:
    """Messages that came in one step.

    Attributes:
        time: its end [ns].
    """

    time: int
    messages: tuple[Recorded, ...]


class RecordedDrive:
    """A ROS 2 log, message by message.

    Args:
        topics: that are read; None for all.
        rig: of the vehicle: clouds whose points have times are played once the last of them was measured.

    Raises:
        LogError: no such log, or not one of ROS 2.
    """

    def __init__(self, path: Path, rig: Rig | None = None, topics: Sequence[str] | None = None) -> None:
        self.path, notes = path, list[str]()
        if not path.exists():
            raise LogError("no such log", where=path, how="give an .mcap or .db3, or the folder of a ROS 2 bag")
        self._readers = open_readers(path, notes)
        self.notes, self._lidars = tuple(notes), _with_times(rig)
        connections = [c for reader in self._readers for c in reader.connections if topics is None or c.topic in topics]
        if not all(isinstance(c.ext, ConnectionExtRosbag2) for c in connections):
            how = "convert it: rosbags-convert --src FILE.bag --dst FOLDER"
            raise LogError("is a log of ROS 1", where=path, how=how)
        if not connections:
            raise LogError("has none of the topics", where=path, how=f"they are {', '.join(topics or ())}")
        self.types = {c.topic: c.msgtype for c in connections}
        self._connections = connections

    @property
    def seconds(self) -> float:
        """Length of the log [s]."""
        ends: list[int] = []
        for reader in self._readers:
            if isinstance(reader, StreamedMcap):  # has no index
                times = [received for _, received, _ in reader.messages(reader.connections)]
                ends += times[:1] + times[-1:]
            else:
                ends += [reader.start_time, reader.end_time]
        return (max(ends) - min(ends)) / 1e9

    def steps(self) -> Iterator[LogStep]:
        """All steps, also those without a message."""
        step, batch, until = round(DT * 1e9), list[Recorded](), None
        for message in self._ordered():
            until = message.time + step if until is None else until
            while message.time > until:
                yield LogStep(until, tuple(batch))
                batch, until = [], until + step
            batch.append(message)
        if until is not None:
            yield LogStep(until, tuple(batch))

    def _ordered(self) -> Iterator[Recorded]:
        """Messages in the order in which they are played."""
        waiting: list[tuple[int, int, Recorded]] = []
        for number, message in enumerate(self._messages()):
            played = max(message.time, self._complete(message))
            while waiting and waiting[0][0] <= message.time:
                yield heapq.heappop(waiting)[2]
            entry = Recorded(played, message.topic, message.type, message.data)
            heapq.heappush(waiting, (played, number, entry))
        while waiting:
            yield heapq.heappop(waiting)[2]

    def _messages(self) -> Iterator[Recorded]:
        self._decoders = {c.topic: whole_messages(c, self.path) for c in self._connections if c.topic in self._lidars}
        wanted = {(c.topic, c.msgtype) for c in self._connections}
        for reader in self._readers:
            chosen = [c for c in reader.connections if (c.topic, c.msgtype) in wanted]
            with reported(self.path, "is damaged"):
                for connection, received, raw in reader.messages(chosen):
                    yield Recorded(received, connection.topic, connection.msgtype, bytes(raw))

    def _complete(self, message: Recorded) -> int:
        """When the last point of a cloud was measured [ns]; 0 for all else."""
        lidar = self._lidars.get(message.topic)
        if lidar is None:
            return 0
        cloud: Any = self._decoders[message.topic](message.data)
        points = points_from_message(cloud)
        if lidar.time_field not in (points.dtype.names or ()) or not len(points):
            return 0
        latest = float(np.max(points[lidar.time_field])) * SECONDS_PER_UNIT[lidar.time_unit]
        stamp = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
        return stamp + round(latest * 1e9) if 0 < latest < _LATEST else 0


def _with_times(rig: Rig | None) -> dict[str, LidarSource]:
    """LiDARs with point times relative to the stamp of the cloud, by topic."""
    lidars = () if rig is None else rig.lidars.values()
    return {one.topic: one for one in lidars if one.time_field and one.time_origin == "stamp"}


def replayed(drive: RecordedDrive, driver: StepDriver, types: MessageTypes) -> Iterator[tuple[float, Step | None]]:
    """Time of each step [s], and what it came to; messages that cannot be decoded are left out."""
    for step in drive.steps():
        now = step.time / 10**9
        heard = []
        for one in step.messages:
            message = decoded(types, one.type, one.data)
            if message is not None:
                heard.append(Heard(one.topic, message, now))
        yield now, driver.step(heard, now)


def decoded(types: MessageTypes, msgtype: str, data: bytes) -> object | None:
    """A message; None where it cannot be decoded, as the transport refuses it."""
    try:
        return types.store.deserialize_cdr(data, msgtype)
    except Exception:  # noqa: BLE001 - whatever damaged bytes make rosbags raise
        return None


OnStep = Callable[[float, Step | None], None]
"""Is given each step: its time [s], and what it came to."""
