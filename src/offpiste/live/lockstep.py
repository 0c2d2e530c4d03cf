"""Lockstep over the transport: a command for each message on /clock, however long it takes."""

import queue
import threading
from typing import Final

import numpy as np

from offpiste.errors import LiveError
from offpiste.live.command_messages import CommandMessages
from offpiste.live.driver import Heard, StepDriver
from offpiste.live.reception import Reception
from offpiste.live.replay import OnStep
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
"""Longest time between two messages on /clock [s]."""


class Lockstep:
    """Answers each message on /clock with a command.

    Args:
        outputs: None in shadow mode: nothing is sent to the vehicle.
    """

    def __init__(
        self, transport: Transport, driver: StepDriver, reception: Reception, outputs: CommandMessages | None
    ) -> None:
        self._transport, self._driver = transport, driver
        self._received: queue.SimpleQueue[Received] = queue.SimpleQueue()
        for topic, history in reception.topics.items():
            transport.subscribe(topic, self._received.put, msgtype=reception.type_of(topic), history=history)
        transport.subscribe(CLOCK, self._received.put, msgtype="rosgraph_msgs/msg/Clock")
        transport.subscribe(END, self._received.put, msgtype="std_msgs/msg/String")
        self._answer = transport.publisher(COMMAND, "sensor_msgs/msg/Joy")
        self._outputs = outputs
        topics = {} if outputs is None else outputs.topics
        self._publish = {topic: transport.publisher(topic, msgtype) for topic, msgtype in topics.items()}
        transport.publisher(READY, "std_msgs/msg/String", keep=True)(make("std_msgs/String", data="ready"))

    def run(self, on_step: OnStep, stop: threading.Event) -> None:
        """Step until asked to stop, until the log is played, or until /clock falls silent.

        Raises:
            LiveError: /clock was never heard.
        """
        batch, now, steps = list[Received](), 0.0, 0
        while not stop.is_set():
            try:
                received = self._received.get(timeout=_WAIT if steps else 10 * _WAIT)
            except queue.Empty:
                if steps:
                    return
                raise LiveError("/clock was not heard", how="start `offpiste play LOG --lockstep`") from None
            if received.topic == END:
                return
            if received.topic != CLOCK:
                batch.append(received)
                continue
            clock = self._transport.decode(received)
            if clock is None:
                continue
            nanoseconds = clock.clock.sec * 10**9 + clock.clock.nanosec
            now, steps = nanoseconds / 10**9, steps + 1
            messages = [(one.topic, self._transport.decode(one)) for one in batch]
            heard = [Heard(topic, message, now) for topic, message in messages if message is not None]
            batch = []
            step = self._driver.step(heard, now)
            if step is not None and self._outputs is not None:
                for topic, message in self._outputs.messages(step.command).items():
                    self._publish[topic](message)
            axes = np.zeros(0, np.float32) if step is None else step.command.control.astype(np.float32)
            head = header(nanoseconds, "base_link")
            self._answer(make("sensor_msgs/Joy", header=head, axes=axes, buttons=np.zeros(0, np.int32)))
            on_step(now, step)
