"""Lockstep over the transport: a command for each step of /clock, however long it takes."""

import queue
import threading
import time
from typing import Final

import numpy as np

from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError
from offpiste.live.backlog import Batch
from offpiste.live.command_messages import Command, CommandMessages
from offpiste.live.driver import STEP_NS, Heard, StepDriver
from offpiste.live.log_steps import OnStep
from offpiste.live.reception import Reception
from offpiste.logs.ros.writer import header, make
from offpiste.transport.interface import Received, Transport

CLOCK: Final = "/clock"
COMMAND: Final = "/offpiste/command"
"""Topic on which every command is published, sent or not: sensor_msgs/Joy with throttle, brake, steer."""
READY: Final = "/offpiste/ready"
"""Topic of a kept message that says that all subscriptions are there."""
END: Final = "/offpiste/end"
"""Topic of a message that ends a lockstep: the log is played."""
_WAIT: Final = 60.0
"""Longest time between two messages on /clock, and from the first message to /clock [s]."""
_BEGINS: Final = 600.0
"""Longest time until the first message [s]."""
_HELD: Final = 128 << 20
"""Size of the images or scans of one topic that are kept for the next step [bytes]."""
_STILL: Final = 2.0
"""Once the clock has stood still for so long, the stop is sent [s]: a simulator's step may take its time."""
_LOOK: Final = 0.2
_STOPS: Final = 5
"""Number of stops that are sent at the end."""
_EARLY: Final = STEP_NS // 10
"""So much before it is due, a step is made where /clock has another period [ns]."""
_BEHIND: Final = 50
"""Steps that may wait; where more do, nobody waits for the commands, and they would come later and later."""


class Lockstep:
    """Answers /clock with a command once every `conventions.DT`.

    Args:
        outputs: None in shadow mode: nothing is sent to the vehicle.
    """

    def __init__(
        self, transport: Transport, driver: StepDriver, reception: Reception, outputs: CommandMessages | None
    ) -> None:
        self._transport, self._driver = transport, driver
        self._received: queue.SimpleQueue[Received] = queue.SimpleQueue()
        self._clocks, self._last, self._commanded = 0, -1, False
        self._due, self._lock, self._batch = 0, threading.Lock(), Batch(reception.sensors.measured, _HELD)
        for topic, history in reception.topics.items():
            transport.subscribe(topic, self._received.put, msgtype=reception.type_of(topic), history=history)
        transport.subscribe(CLOCK, self._clock, msgtype="rosgraph_msgs/msg/Clock")
        transport.subscribe(END, self._received.put, msgtype="std_msgs/msg/String")
        self._answer = transport.publisher(COMMAND, "sensor_msgs/msg/Joy")
        self._outputs = outputs
        topics = {} if outputs is None else outputs.topics
        self._publish = {topic: transport.publisher(topic, msgtype) for topic, msgtype in topics.items()}
        for topic in topics:
            transport.subscribe(topic, self._other, unchecked=True)
        transport.publisher(READY, "std_msgs/msg/String", keep=True)(make("std_msgs/String", data="ready"))

    def run(self, on_step: OnStep, stop: threading.Event, seconds: float = np.inf) -> None:
        """Step until asked to stop, until the log is played, or until /clock falls silent; then stop the vehicle.

        Args:
            seconds: it ends after so much time on /clock [s].

        Raises:
            LiveError: /clock was never heard, or does not wait for the commands.
        """
        try:
            self._run(on_step, stop, seconds)
        finally:
            for _ in range(_STOPS if self._commanded else 0):
                self._send(self._driver.stop)
                time.sleep(DT)

    def _run(self, on_step: OnStep, stop: threading.Event, seconds: float) -> None:
        first, moved = -1, time.monotonic()
        while not stop.is_set():
            try:
                received = self._received.get(timeout=_LOOK)
            except queue.Empty:
                received = None
            silent = time.monotonic() - moved
            if silent > _STILL and self._commanded:
                self._send(self._driver.stop)  # the clock stands still, the vehicle may not
            if received is not None and received.topic == END:
                return
            if received is None or received.topic != CLOCK:
                if silent > (_WAIT if self._last >= 0 or self._batch else _BEGINS):
                    if self._last >= 0:
                        return
                    raise LiveError("/clock was not heard", how="start `offpiste play LOG --lockstep`")
                if received is not None:
                    if self._last < 0 and not self._batch:
                        moved = time.monotonic()
                    self._batch.add(received)
                continue
            if self._clocks > _BEHIND:
                how = "let it wait (`offpiste play --lockstep`), or leave out --lockstep"
                raise LiveError("/clock does not wait for the commands", how=how)
            with self._lock:
                self._clocks -= 1
            clock = self._transport.decode(received)
            nanoseconds = -1 if clock is None else clock.clock.sec * 10**9 + clock.clock.nanosec
            if nanoseconds in (-1, self._last):  # a clock that stands still is no step
                continue
            back = nanoseconds < self._last
            self._last, first = nanoseconds, nanoseconds if first < 0 else first
            if back or nanoseconds >= self._due - _EARLY:  # limits of rate count by steps
                self._due += STEP_NS
                if back or nanoseconds >= self._due:
                    self._due = nanoseconds + STEP_NS
                self._step(self._batch.taken(), nanoseconds, on_step)
            moved = time.monotonic()  # however long the step took
            if (nanoseconds - first) / 1e9 >= seconds:
                return

    def _step(self, batch: list[Received], nanoseconds: int, on_step: OnStep) -> None:
        """Answer a message on /clock."""
        now = nanoseconds / 10**9
        if any(one.topic in self._publish and not one.data for one in batch):
            self._driver.other(now)
        decoded = [(one, self._transport.decode(one)) for one in batch if one.type]
        heard = [Heard(one.topic, message, now, one.publisher) for one, message in decoded if message is not None]
        step = self._driver.step(heard, now)
        if step is not None:
            self._send(step.command)
        axes = np.zeros(0, np.float32) if step is None else step.command.control.astype(np.float32)
        head = header(nanoseconds, "base_link")
        self._answer(make("sensor_msgs/Joy", header=head, axes=axes, buttons=np.zeros(0, np.int32)))
        on_step(now, step)

    def _send(self, command: Command) -> None:
        """Send a command to the vehicle; in shadow mode nothing."""
        if self._outputs is not None:
            self._commanded = True
            for topic, message in self._outputs.messages(command).items():
                self._publish[topic](message)

    def _clock(self, received: Received) -> None:
        """Called in the transport's thread."""
        with self._lock:
            self._clocks += 1
        self._received.put(received)

    def _other(self, received: Received) -> None:
        if received.publisher[:8] != self._transport.identity:
            self._received.put(received)
