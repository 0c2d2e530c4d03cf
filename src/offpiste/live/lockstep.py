"""Driving in one process by the steps of a clock: equal messages give equal commands, to the bit.

`StepDriver` steps the run time; `Lockstep` runs it over a transport, and `play.replayed` over a log.
"""

import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from offpiste.core.channels import all_actuators
from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError
from offpiste.live.command_messages import Command, CommandMessages, joy_message
from offpiste.live.gate import Checked, Gate
from offpiste.live.reception import Pressed, Reception, Taken
from offpiste.live.robot_messages import Sensors
from offpiste.live.session import CLOCK, COMMAND, END, READY
from offpiste.logs.measurements import Cloud, Image
from offpiste.logs.ros.bag_files import heard_at
from offpiste.logs.ros.writer import make
from offpiste.perception.camera import make_pinhole_camera
from offpiste.planning.course import Course, CourseTracker
from offpiste.rig.outputs import can_reverse
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.modes import Controls
from offpiste.runtime.perception import SensorSetup
from offpiste.runtime.planner import Planner
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.settings import RuntimeSettings
from offpiste.transport.interface import Received, Transport

_STEP_NS: Final = round(DT * 1e9)
_WAIT: Final = 60.0
"""Maximum time between messages on /clock, and from the first message to /clock [s]."""
_BEGINS: Final = 600.0
"""Maximum time until the first message [s]."""
_HELD: Final = 128 << 20
"""Maximum size of the images or scans of one topic that wait for the next step [bytes]."""
_STILL: Final = 2.0
"""Time without a new stamp on /clock after which the stop is sent [s]; steps of a simulator may be slow."""
_LOOK: Final = 0.2
_STOPS: Final = 5
"""Number of stops sent at the end."""
_EARLY: Final = _STEP_NS // 10
"""Time before the due time at which a step is made if /clock has another period [ns]."""
_BEHIND: Final = 50
"""Maximum number of waiting steps; more show that the clock does not wait for commands."""


class Heard(NamedTuple):
    """Decoded message, its arrival [s], and the identity of its publisher if known."""

    topic: str
    message: Any
    received: float
    publisher: bytes = b""


@dataclass(frozen=True)
class Step:
    """Result of a step.

    Attributes:
        controls: of the run time.
        command: to be sent; in shadow mode, the command that would be sent.
        why: the gate's reason for a stop; else empty.
    """

    controls: Controls
    command: Command
    why: str


OnStep = Callable[[float, Step | None], None]
"""Callback for each step: its time [s] and its result."""


class StepDriver:
    """Step the run time on messages of a robot.

    Args:
        shadow: another driver commands the vehicle; plans start from those commands if the rig has their channels.
        seed: of the sampled controls.

    Attributes:
        runtime: None until all required messages have arrived.
    """

    def __init__(
        self,
        rig: Rig,
        planner: Planner,
        reception: Reception,
        settings: RuntimeSettings | None = None,
        *,
        shadow: bool = True,
        seed: int = 0,
    ) -> None:
        refuse_unmeasured(planner, rig)
        self._rig, self._planner, self._reception = rig, planner, reception
        self._settings, self._shadow, self._seed = settings or RuntimeSettings(), shadow, seed
        # Shadow mode sends nothing and needs no switch.
        self._gate = Gate(rig.live.limits, None if shadow else rig.live.enable, self._settings.stop)
        self._now = -np.inf
        self.runtime: Runtime | None = None

    def step(self, heard: Iterable[Heard], now: float) -> Step | None:
        """Take the messages since the last step and return the command for the next `conventions.DT`.

        Args:
            now: time [s].

        Returns:
            None while a required message is missing.
        """
        if now < self._now:
            self._gate.restart(now)
        self._now = now
        for topic, message, received, publisher in self._in_order(heard):
            for taken in self._reception.take(topic, message, received):
                if isinstance(taken, Pressed):
                    self._gate.enabled(taken.pressed, now, age=taken.age, publisher=publisher)
                self._pass_on(taken)
        if (runtime := self.runtime) is None:
            return None
        passed: list[Checked] = []

        def applied(controls: Controls) -> np.ndarray:
            stopping = controls.mode in ("stopping", "stopped")
            passed.append(self._gate.check(controls.command, runtime.follower.speed, now, stopping=stopping))
            return passed[-1].control

        if self._shadow:  # another driver need not complete our stops
            runtime.follower.stopping = False
            runtime.follower.driver = self._reception.vehicle.given(now)
        held = "" if self._shadow else self._gate.blocked(now)
        controls = runtime.step(now, applied, held)
        followed = runtime.prediction_at(now) if controls.mode in ("driving", "degraded") else None
        stopped = passed[-1].why != ""
        command = Command(now, passed[-1].control, controls.gear, None if stopped else followed)
        return Step(controls, command, passed[-1].why)

    def other(self, now: float) -> None:
        """Take note of a command from another publisher."""
        if not self._shadow:
            self._gate.other(now)

    @property
    def stop(self) -> Command:
        """Stop with the last steering sent."""
        control = np.array((0.0, self._settings.stop, self._gate.steer))
        gear = self._settings.gear if self.runtime is None else self.runtime.follower.gear
        return Command(max(self._now, 0.0), control, gear)

    def _in_order(self, heard: Iterable[Heard]) -> list[Heard]:
        """Sort vehicle messages by stamp, with the position last at equal stamps, before all others."""
        vehicle = self._reception.vehicle

        def order(one: Heard) -> tuple[bool, float, bool]:
            if one.topic not in vehicle.topics:
                return True, 0.0, False
            stamp = heard_at(one.received, one.message, self._rig.clock.stamps)
            return False, -math.inf if math.isnan(stamp) else stamp, one.topic == vehicle.position_topic

        return sorted(heard, key=order)

    def _pass_on(self, taken: Taken) -> None:
        if self.runtime is None:
            sensors, course = self._reception.sensors.sensors, self._reception.course
            if sensors is None or course is None:
                return
            setup = sensor_setup_of(self._planner, sensors)
            wheels = self._rig.wheel_positions()
            self.runtime = Runtime(
                self._planner.dynamics, setup, wheels, course, self._settings,
                seed=self._seed, spread=self._planner.spread,
                reverses=not self._shadow and can_reverse(self._rig.outputs),
            )  # fmt: skip
        if isinstance(taken, VehicleReading):
            self.runtime.vehicle(taken)
        elif isinstance(taken, Image):
            self.runtime.image(taken)
        elif isinstance(taken, Cloud):
            self.runtime.scan(taken)
        elif isinstance(taken, Course):
            self.runtime.follower.tracker = CourseTracker(taken)


def sensor_setup_of(planner: Planner, sensors: Sensors) -> SensorSetup:
    """Return the sensors of a robot in the form of a planner's run time."""
    cameras, lidars = sensors
    if planner.extractor is None:
        return SensorSetup(lidars)
    patch = planner.extractor.patch
    pinholes = {name: make_pinhole_camera(camera, patch) for name, camera in cameras.items()}
    return SensorSetup(lidars, pinholes, planner.extractor.extract)


def refuse_unmeasured(planner: Planner, rig: Rig) -> None:
    """Raise `LiveError` for a model whose inputs the robot lacks: true ground, actuators, or images."""
    if planner.knows_ground:
        how = "give a run trained on visual features, or on none"
        raise LiveError("reads the ground's true properties, which no robot has", where=planner.folder, how=how)
    lacks = [name for name in planner.dynamics.vehicle.actuators if name not in rig.present_actuators]
    if lacks:
        known = {actuator.name: actuator for actuator in all_actuators()}
        needed = dict.fromkeys(known[known[name].rate_of or name].channel for name in lacks)
        how = f"add {', '.join(f'[channels.{name}]' for name in needed)} to the rig, or give a run trained without them"
        what = f"the model reads {', '.join(lacks)}, which rig '{rig.name}' does not have"
        raise LiveError(what, where=planner.folder, how=how)
    if planner.extractor is not None and not rig.cameras:
        how = "add its cameras to the rig, or give a run that reads no images"
        raise LiveError(f"the model reads images, and rig '{rig.name}' has no cameras", where=planner.folder, how=how)


class Batch:
    """Messages until the next step, in order; of large topics only the newest ones.

    Args:
        large: topics whose size is limited.
        size: limit for each of them [bytes]; the newest message is always kept.
    """

    def __init__(self, large: Collection[str], size: int) -> None:
        self._size, self._count = size, 0
        self._messages: dict[int, Received] = {}
        self._large = {topic: deque[int]() for topic in large}

    def __len__(self) -> int:
        return len(self._messages)

    def add(self, received: Received) -> None:
        """Add a message."""
        self._messages[self._count] = received
        if (numbers := self._large.get(received.topic)) is not None:
            numbers.append(self._count)
            while len(numbers) > 1 and sum(len(self._messages[number].data) for number in numbers) > self._size:
                del self._messages[numbers.popleft()]
        self._count += 1

    def taken(self) -> list[Received]:
        """Remove and return all messages."""
        messages, self._messages = list(self._messages.values()), {}
        for numbers in self._large.values():
            numbers.clear()
        return messages


class Lockstep:
    """Answer /clock with a command once every `conventions.DT`, however long that takes.

    Args:
        outputs: None in shadow mode, where nothing is sent to the vehicle.
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
        self._commands = None if outputs is None else outputs.sender(transport)
        self._outputs = set() if outputs is None else set(outputs.topics)
        for topic in self._outputs:
            transport.subscribe(topic, self._other, unchecked=True)
        transport.publisher(READY, "std_msgs/msg/String", keep=True)(make("std_msgs/String", data="ready"))

    def run(self, on_step: OnStep, stop: threading.Event, seconds: float = np.inf) -> None:
        """Step until `stop` is set, the log ends, or /clock falls silent; then stop the vehicle.

        Args:
            seconds: maximum duration on /clock [s].

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
                self._send(self._driver.stop)  # the clock stands still, but the vehicle may not
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
            if nanoseconds in (-1, self._last):  # a repeated stamp is no step
                continue
            back = nanoseconds < self._last
            self._last, first = nanoseconds, nanoseconds if first < 0 else first
            if back or nanoseconds >= self._due - _EARLY:  # rate limits count by steps
                self._due += _STEP_NS
                if back or nanoseconds >= self._due:
                    self._due = nanoseconds + _STEP_NS
                self._step(self._batch.taken(), nanoseconds, on_step)
            moved = time.monotonic()  # however long the step took
            if (nanoseconds - first) / 1e9 >= seconds:
                return

    def _step(self, batch: list[Received], nanoseconds: int, on_step: OnStep) -> None:
        """Answer a message on /clock."""
        now = nanoseconds / 10**9
        if any(one.topic in self._outputs and not one.data for one in batch):
            self._driver.other(now)
        decoded = [(one, self._transport.decode(one)) for one in batch if one.type]
        heard = [Heard(one.topic, message, now, one.publisher) for one, message in decoded if message is not None]
        step = self._driver.step(heard, now)
        if step is not None:
            self._send(step.command)
        self._answer(joy_message(nanoseconds, np.zeros(0) if step is None else step.command.control))
        on_step(now, step)

    def _send(self, command: Command) -> None:
        """Send a command to the vehicle, except in shadow mode."""
        if self._commands is not None:
            self._commanded = True
            self._commands(command)

    def _clock(self, received: Received) -> None:
        """Queue a message of /clock; called in the transport's thread."""
        with self._lock:
            self._clocks += 1
        self._received.put(received)

    def _other(self, received: Received) -> None:
        if received.publisher[:8] != self._transport.identity:
            self._received.put(received)
