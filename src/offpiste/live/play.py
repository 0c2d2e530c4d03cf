"""Plays a log over the transport, with /clock: in real time, or in lockstep with the run time."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError
from offpiste.core.progress import track
from offpiste.live.lockstep import CLOCK, COMMAND, END, READY
from offpiste.live.log_steps import LogStep, RecordedDrive
from offpiste.logs.ros.writer import make
from offpiste.transport.zenoh_transport import ZenohTransport

_ANSWER: Final = 120.0
"""Longest time that an answer is waited for in lockstep [s]: the first plan may wait for the compiler."""
_KEPT: Final = ("/tf_static", "/robot_description", "/map")
"""Topics that ROS keeps for those who come later."""
_OURS: Final = "/offpiste/"
"""Beginning of the topics of `offpiste live`."""

OnStep = Callable[[LogStep], None]
"""Is called with each step."""


@dataclass(frozen=True)
class Played:
    """What was played.

    Attributes:
        steps, messages: number of them.
        late: longest time that a step came too late [s].
    """

    steps: int
    messages: int
    late: float


class LogPlayer:
    """Publishes the messages of a log.

    Args:
        without: topics that are left out, e.g. the commands that were recorded; /clock, which is made anew, and what
            offpiste published are left out, too.
    """

    def __init__(self, drive: RecordedDrive, transport: ZenohTransport, without: tuple[str, ...] = ()) -> None:
        self._drive, self._transport = drive, transport
        others = {topic: kind for topic, kind in drive.types.items() if topic != CLOCK and not topic.startswith(_OURS)}
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
            rate: times as fast as it was recorded.
            seconds: of the log that are played [s].

        Raises:
            LiveError: the rate is none.
        """
        if not 0 < rate <= 100:
            raise LiveError(f"a rate of {rate:g}", where="--rate", how="give one above 0, and at most 100")
        began, first, late = time.monotonic(), 0, [0.0]

        def pace(step: LogStep) -> None:
            nonlocal first
            first = first or step.time
            due = began + (step.time - first) / 1e9 / rate
            late[0] = max(late[0], time.monotonic() - due)
            time.sleep(max(due - time.monotonic(), 0.0))

        steps, messages = self._each(seconds, pace, lambda _: None)
        return Played(steps, messages, late[0])

    def play_in_lockstep(self, seconds: float) -> Played:
        """Play step by step: the next one follows the run time's command.

        Raises:
            LiveError: nobody answers.
        """
        if not self._ready.wait(_ANSWER):
            raise LiveError("nobody is ready to drive", how="start `offpiste live … --lockstep` first")
        time.sleep(0.3)  # routes to its subscriptions are set up

        def wait(step: LogStep) -> None:
            while self._answer != step.time:
                if not self._answered.wait(_ANSWER):
                    raise LiveError("no command came back", how="see what `offpiste live … --lockstep` says")
                self._answered.clear()

        steps, messages = self._each(seconds, lambda _: None, wait)
        return Played(steps, messages, 0.0)

    def _each(self, seconds: float, before: OnStep, after: OnStep) -> tuple[int, int]:
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
    """A rosgraph_msgs/Clock."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return make("rosgraph_msgs/Clock", clock=make("builtin_interfaces/Time", sec=seconds, nanosec=rest))
