"""Recorded drives in steps of a clock: replay to the run time, or play over a transport with /clock."""

import heapq
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from rosbags.interfaces import ConnectionExtRosbag2

from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError, LogError
from offpiste.core.progress import track
from offpiste.live.lockstep import Heard, Step, StepDriver
from offpiste.live.session import CLOCK, COMMAND, END, READY
from offpiste.logs.ros.bag_files import open_readers, reported, whole_messages
from offpiste.logs.ros.mcap_recovery import StreamedMcap
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.logs.ros.writer import make
from offpiste.rig.channels import SECONDS_PER_UNIT
from offpiste.rig.rig import Rig
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.zenoh_transport import ZenohTransport

_LATEST: Final = 1.0
"""Maximum duration of a LiDAR revolution [s]; larger point times are ignored."""
_ANSWER: Final = 120.0
"""Maximum wait for an answer in lockstep [s]; the first plan may wait for the compiler."""
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
    """Messages of a ROS 2 log.

    Args:
        rig: of the vehicle: clouds with point times are played at the time of their last point.
        topics: to be read; None for all.

    Raises:
        LogError: the log is missing, or not of ROS 2.
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


def replayed(drive: RecordedDrive, driver: StepDriver, types: MessageTypes) -> Iterator[tuple[float, Step | None]]:
    """Yield the time [s] and result of each step; messages that cannot be decoded are dropped."""
    for step in drive.steps():
        now = step.time / 10**9
        decoded = ((one.topic, types.decoded(one.type, one.data)) for one in step.messages)
        yield now, driver.step([Heard(topic, message, now) for topic, message in decoded if message is not None], now)


class Played(NamedTuple):
    """Number of steps and messages played, and the maximum delay of a step [s]."""

    steps: int
    messages: int
    late: float


class LogPlayer:
    """Publish the messages of a log.

    Args:
        without: further topics to leave out, e.g. recorded commands; /clock is generated, and topics of offpiste are
            left out.
    """

    def __init__(self, drive: RecordedDrive, transport: ZenohTransport, without: tuple[str, ...] = ()) -> None:
        self._drive, self._transport = drive, transport
        others = {t: kind for t, kind in drive.types.items() if t != CLOCK and not t.startswith("/offpiste/")}
        known = {topic: kind for topic, kind in others.items() if kind in transport.types and topic not in without}
        self.left_out = tuple(sorted(set(drive.types) - set(known)))
        self._publish = {
            topic: transport.raw_publisher(topic, kind, keep=topic in _KEPT or topic.endswith("/camera_info"))
            for topic, kind in known.items()
        }
        self._clock = transport.publisher(CLOCK, "rosgraph_msgs/msg/Clock")
        self._answered, self._answer = threading.Event(), 0
        self._ready = threading.Event()
        self._end = transport.publisher(END, "std_msgs/msg/String")
        transport.subscribe(COMMAND, self._heard, msgtype="sensor_msgs/msg/Joy")
        transport.subscribe(READY, lambda _: self._ready.set(), msgtype="std_msgs/msg/String", history=True)

    def play(self, rate: float, seconds: float) -> Played:
        """Play in real time.

        Args:
            rate: speed relative to the recording.
            seconds: maximum duration of the log to be played [s].

        Raises:
            LiveError: the rate is out of range.
        """
        if not 0 < rate <= 100:
            raise LiveError(f"a rate of {rate:g}", where="--rate", how="give a rate above 0, and at most 100")
        began, first, late = time.monotonic(), 0, 0.0

        def pace(step: LogStep) -> None:
            nonlocal first, late
            first = first or step.time
            due = began + (step.time - first) / 1e9 / rate
            late = max(late, time.monotonic() - due)
            time.sleep(max(due - time.monotonic(), 0.0))

        steps, messages = self._each(seconds, pace, lambda _: None)
        return Played(steps, messages, late)

    def play_in_lockstep(self, seconds: float) -> Played:
        """Play step by step, waiting for the run time's command after each.

        Raises:
            LiveError: no command arrives.
        """
        if not self._ready.wait(_ANSWER):
            raise LiveError("no `offpiste live` is ready", how="start `offpiste live … --lockstep` first")
        time.sleep(0.3)  # until the routes to its subscriptions exist

        def wait(step: LogStep) -> None:
            while self._answer != step.time:
                if not self._answered.wait(_ANSWER):
                    raise LiveError("no command came back", how="see the output of `offpiste live … --lockstep`")
                self._answered.clear()

        steps, messages = self._each(seconds, lambda _: None, wait)
        return Played(steps, messages, 0.0)

    def _each(
        self, seconds: float, before: Callable[[LogStep], None], after: Callable[[LogStep], None]
    ) -> tuple[int, int]:
        messages, steps = 0, 0
        total = round(min(seconds, self._drive.seconds + DT) / DT)
        for _, step in zip(track(range(total), f"play {self._drive.path.name}"), self._drive.steps(), strict=False):
            before(step)
            for one in step.messages:
                if one.topic in self._publish:
                    self._publish[one.topic](one.data)
                    messages += 1
            self._clock(clock_message(step.time))
            steps += 1
            after(step)
        self._end(make("std_msgs/String", data="played"))
        time.sleep(0.2)  # until it is sent
        return steps, messages

    def _heard(self, received: Any) -> None:
        command = self._transport.decode(received)
        if command is not None:
            self._answer = command.header.stamp.sec * 10**9 + command.header.stamp.nanosec
            self._answered.set()


def clock_message(nanoseconds: int) -> Any:
    """Return a rosgraph_msgs/Clock."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return make("rosgraph_msgs/Clock", clock=make("builtin_interfaces/Time", sec=seconds, nanosec=rest))
