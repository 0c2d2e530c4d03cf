"""Recorded drives in steps of a clock, and their playback over a transport with /clock."""

import heapq
import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from rosbags.interfaces import ConnectionExtRosbag2

from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError, LogError, require
from offpiste.core.progress import track
from offpiste.live.part import freeze_loaded_objects
from offpiste.live.session import CLOCK
from offpiste.logs.ros.bag_files import open_readers, reported, whole_messages
from offpiste.logs.ros.mcap_recovery import StreamedMcap
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.logs.ros.writer import header, make
from offpiste.rig.channels import SECONDS_PER_UNIT
from offpiste.rig.rig import Rig, load_rig
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport

logger = logging.getLogger(__name__)

_LATEST: Final = 1.0
"""Maximum duration of a LiDAR revolution [s]; larger point times are ignored."""
_KEPT: Final = ("/tf_static", "/robot_description", "/map")
"""Topics that ROS latches."""


class Recorded(NamedTuple):
    """Message of a log: the time at which it is played [ns], and its CDR data."""

    time: int
    topic: str
    type: str
    data: bytes


class LogStep(NamedTuple):
    """End of a step [ns] and its messages."""

    time: int
    messages: tuple[Recorded, ...]


class RecordedDrive:
    """Messages of a ROS 2 log, of some topics or all.

    Args:
        rig: of the vehicle: clouds with point times are played at the time of their last point.
    """

    def __init__(self, path: Path, rig: Rig | None = None, topics: Sequence[str] | None = None) -> None:
        self.path = path
        if not path.exists():
            raise LogError("no such log", where=path, how="give an .mcap or .db3, or the folder of a ROS 2 bag")
        self._readers = open_readers(path, [])
        lidars = () if rig is None else rig.lidars.values()
        self._lidars = {one.topic: one for one in lidars if one.time_field and one.time_origin == "stamp"}
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
        """Duration of the log [s]."""
        ends: list[int] = []
        for reader in self._readers:
            if isinstance(reader, StreamedMcap):  # has no index
                times = [received for _, received, _ in reader.messages(reader.connections)]
                ends += times[:1] + times[-1:]
            else:
                ends += [reader.start_time, reader.end_time]
        return (max(ends) - min(ends)) / 1e9

    def steps(self) -> Iterator[LogStep]:
        """Yield all steps, including those without a message."""
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
        """Yield messages in the order in which they are played."""
        waiting: list[tuple[int, int, Recorded]] = []
        for number, message in enumerate(self._messages()):
            played = max(message.time, self._complete(message))
            while waiting and waiting[0][0] <= message.time:
                yield heapq.heappop(waiting)[2]
            heapq.heappush(waiting, (played, number, message._replace(time=played)))
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
        """Return the time of a cloud's last point [ns]; 0 for other messages."""
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


class LogPlayer:
    """Publish the messages of a log in real time, and /clock after each step.

    Args:
        without: topics to leave out, e.g. recorded commands, in addition to /clock and those of offpiste.

    Attributes:
        left_out: topics that are not played.
    """

    def __init__(self, drive: RecordedDrive, transport: ZenohTransport, without: tuple[str, ...] = ()) -> None:
        self._drive = drive
        self._publish = {
            topic: transport.raw_publisher(topic, kind, keep=topic in _KEPT or topic.endswith("/camera_info"))
            for topic, kind in drive.types.items()
            if kind in transport.types and topic not in (CLOCK, *without) and not topic.startswith("/offpiste/")
        }
        self.left_out = tuple(sorted(set(drive.types) - set(self._publish)))
        self._clock = transport.publisher(CLOCK, "rosgraph_msgs/msg/Clock")

    def play(self, rate: float, seconds: float) -> tuple[int, int, float]:
        """Play at most so many seconds of the log, at a rate relative to the recording.

        Returns:
            Number of steps and messages played, and the maximum delay of a step [s].
        """
        if not 0 < rate <= 100:
            raise LiveError(f"invalid rate {rate:g}", where="--rate", how="give a rate above 0, and at most 100")
        began, late, messages, steps = time.monotonic(), 0.0, 0, 0
        total = round(min(seconds, self._drive.seconds + DT) / DT)
        for _, step in zip(track(range(total), f"play {self._drive.path.name}"), self._drive.steps(), strict=False):
            due = began + steps * DT / rate
            late = max(late, time.monotonic() - due)
            time.sleep(max(due - time.monotonic(), 0.0))
            for one in step.messages:
                if one.topic in self._publish:
                    self._publish[one.topic](one.data)
                    messages += 1
            self._clock(clock_message(step.time))
            steps += 1
        time.sleep(0.2)  # until the last message is sent
        return steps, messages, late


def clock_message(nanoseconds: int) -> Any:
    """Return a rosgraph_msgs/Clock."""
    return make("rosgraph_msgs/Clock", clock=header(nanoseconds, "").stamp)


def play_log(
    log: Path, rig: str, robot: ZenohSettings, rate: float, seconds: float, *, without: tuple[str, ...] = ()
) -> None:
    """Play a log; raises `OffpisteError` for an invalid option, log, rig or connection."""
    if not seconds > 0:
        raise LiveError(f"{seconds:g} seconds", where="--seconds", how="give more than 0")
    require("live", "zenoh")
    known = load_rig(rig) if rig else None
    drive = RecordedDrive(log, known, None if known is None else known.topics)
    with closing(ZenohTransport(robot)) as transport:
        player = LogPlayer(drive, transport, without)
        if player.left_out:
            logger.info(f"left out: {', '.join(player.left_out)}")
        freeze_loaded_objects()
        steps, messages, late = player.play(rate, seconds)
    logger.info(f"played {messages} messages in {steps} steps, {1e3 * late:.0f} ms late at worst")
