"""Process that receives and decodes messages: every reading, and the newest images and scans."""

import threading
from collections import Counter, deque
from dataclasses import replace
from functools import partial
from itertools import count
from time import monotonic
from typing import Final

import numpy as np

from offpiste.core.errors import LiveError
from offpiste.live.part import RUNS_ON, STAMP, Part, freeze_loaded_objects
from offpiste.live.reception import Reception
from offpiste.live.ring import pack_fields, pack_sensors
from offpiste.live.session import CLOCK, Session
from offpiste.logs.measurements import Cloud, Image
from offpiste.planning.course import Course
from offpiste.runtime.estimator import VehicleReading
from offpiste.transport.received import Received, Tally

DEAF: Final = 5.0
"""Time without any message after which the process restarts [s]: the transport's thread may have run out of memory."""
_WAITING: Final = 256
"""Maximum number of readings that wait to be decoded; the same number of calibrations and transforms may wait, too."""


class Backlog:
    """Queue of messages between threads; when full, the largest topic loses its oldest message, but not its only one.

    Args:
        most: maximum number of messages.
        dropped: counter of dropped messages by topic.
        size: maximum total size [bytes].
        why: reason given for dropped messages.
    """

    def __init__(
        self, most: int, dropped: Tally, *, size: int = 1 << 62, why: str = "comes faster than it is decoded"
    ) -> None:
        self._most, self._size, self._dropped, self._why = most, size, dropped, why
        self._waiting: dict[str, deque[tuple[int, Received]]] = {}  # with a number in the order of arrival
        self._bytes, self._numbers = Counter[str](), count()
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def put(self, received: Received) -> None:
        """Add a message."""
        with self._changed:
            self._waiting.setdefault(received.topic, deque()).append((next(self._numbers), received))
            self._bytes[received.topic] += len(received.data)
            while (many := len(self) > self._most) or self._bytes.total() > self._size:
                room = {topic: len(of) if many else self._bytes[topic] for topic, of in self._waiting.items()}
                fullest = max(room, key=lambda topic: (len(self._waiting[topic]) > 1, room[topic]))
                self._dropped.add(f"{self._taken(fullest).topic}: {self._why}")
            self._changed.notify()

    def get(self, timeout: float) -> Received | None:
        """Remove and return the oldest message; None if none arrives within the timeout [s]."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(timeout)
            if not self._waiting:
                return None
            return self._taken(min(self._waiting, key=lambda topic: self._waiting[topic][0][0]))

    def _taken(self, topic: str) -> Received:
        _, received = self._waiting[topic].popleft()
        self._bytes[topic] -= len(received.data)
        if not self._waiting[topic]:
            del self._waiting[topic], self._bytes[topic]
        return received


class Receiver:
    """Write received values to the rings; images and scans are decoded in a thread of their own."""

    def __init__(self, part: Part) -> None:
        self.part, self.transport = part, part.connect()
        self.reception = Reception(part.rig, part.settings.course, cameras=part.settings.cameras)
        self._small, self._calibrations = Backlog(_WAITING, part.dropped), Backlog(_WAITING, part.dropped)
        self._newest: dict[str, Received] = {}
        self._stamp, self._heard_at, self._clock_source = -1.0, np.inf, part.settings.clock
        self._lock, self._any, self._handed_over = threading.Lock(), threading.Event(), False
        for topic, history in self.reception.topics.items():
            msgtype = self.reception.type_of(topic)
            self.transport.subscribe(topic, self._deliver, msgtype=msgtype, history=history)
        if self._clock_source == "clock":
            self.transport.subscribe(CLOCK, self._small.put, msgtype="rosgraph_msgs/msg/Clock")
        if self.reception.course is not None:
            self._course(self.reception.course)
        self._sensing = threading.Thread(target=self._sense, daemon=True)
        self._sensing.start()

    @property
    def state(self) -> str:
        """Description of what is missing and what was refused meanwhile, or "ready"."""
        if waits := self.reception.waiting_for:
            frequent = Counter(self.transport.refused.snapshot()).most_common(3)
            return "; ".join((f"waits for {waits}", *(f"refused: {what}" for what, _ in frequent)))
        late = ", ".join(self.reception.sensors.left_out)
        return f"ready, without {late}: optional, and first heard after the setup of the others" if late else "ready"

    def _deliver(self, received: Received) -> None:
        """Queue a message; called in the transport's thread."""
        self._heard_at = received.steady
        sensors, vehicle = self.reception.sensors, self.reception.vehicle
        sets_clock = self._clock_source == "stamps" and received.topic == vehicle.position_topic
        with self._lock:
            # The arrival of messages without a header is measured by the clock of the others.
            if self._clock_source != "system" and not sets_clock:
                received = replace(received, received=self.part.now())
            if received.topic in sensors.measured:
                if received.topic in self._newest:
                    self.part.dropped.add(f"{received.topic}: replaced by a newer one")
                self._newest[received.topic] = received
                self._any.set()
            elif received.topic in sensors.topics and sensors.sensors is None:
                self._calibrations.put(received)
                self._any.set()
        if received.topic not in sensors.topics or received.topic in vehicle.topics:
            self._small.put(received)

    def read(self) -> None:
        """Process waiting readings, courses and clock messages, at most `_WAITING`, so that signs of life are given."""
        received, most = self._small.get(0.05), _WAITING
        while received is not None:
            self._take(received)
            most -= 1
            received = self._small.get(0.0) if most else None

    def _take(self, received: Received) -> None:
        message = self.transport.decode(received)
        if message is None:
            return
        if received.topic == CLOCK:
            self._clock(message.clock.sec + message.clock.nanosec / 1e9, received.steady)
            return
        for taken in self.reception.take(received.topic, message, received.received):
            if isinstance(taken, VehicleReading):
                if self._clock_source == "stamps":
                    self._clock(taken.time, received.steady)
                given = self.reception.vehicle.given(taken.time)
                self.part.write("readings", pack_fields(taken, **given._asdict(), came=received.steady))
            elif isinstance(taken, Course):
                self._course(taken)

    def _clock(self, stamp: float, steady: float) -> None:
        """Write a new stamp of the clock; a repeated one does not show that it runs."""
        if stamp != self._stamp:
            if self._stamp >= 0 and not -RUNS_ON <= stamp - self._stamp <= RUNS_ON:
                self.part.dropped.add("the clock jumped")
            self._stamp = stamp
            self.part.write("clock", STAMP.pack(stamp, steady))

    def _course(self, course: Course) -> None:
        """Write a course unless it is the current one, as after a restart."""
        newest, data = self.part.ring("course").newest(), pack_fields(course)
        if newest is None or newest.data != data:
            self.part.write("course", data)

    def check(self) -> None:
        """Raise `LiveError` if messages are no longer received or decoded; the process is then restarted."""
        if self.part.ending:
            return
        if not self._sensing.is_alive():
            raise LiveError("images and scans are not decoded any more", how="see its earlier output")
        if self.transport.routers() and monotonic() - self._heard_at > DEAF:
            raise LiveError(f"nothing has been heard for {DEAF:g} s", how="check that the robot still publishes")

    def _sense(self) -> None:
        """Decode the newest image or scan of each sensor."""
        sensors = self.reception.sensors
        while not self.part.ending:
            self._any.wait(0.1)
            self._any.clear()
            waiting = list(iter(partial(self._calibrations.get, 0.0), None))
            with self._lock:
                newest, self._newest = self._newest, {}
            for received in (*waiting, *newest.values()):
                message = self.transport.decode(received)
                taken = message and sensors.take(received.topic, message, received.received)
                if isinstance(taken, Image | Cloud):
                    self.part.write("images" if isinstance(taken, Image) else "scans", pack_fields(taken))
            if sensors.sensors is not None and not self._handed_over:
                self._handed_over = self.part.ring("sensors").write(pack_sensors(sensors.sensors))


def receive(session: Session) -> None:
    """Run the process."""
    part = Part("receive", session)
    receiver, connected = Receiver(part), True
    vehicle, transport = receiver.reception.vehicle, receiver.transport
    freeze_loaded_objects()
    while not part.ended:  # control needs readings until the vehicle is at a standstill
        receiver.read()
        receiver.check()
        routers = transport.routers()
        part.dropped.add("connection to the router lost", connected and not routers)
        connected = routers > 0
        part.beat(
            receiver.state if routers else "no router: nothing is heard or sent",
            refused=transport.refused.snapshot(),
            unusable=vehicle.dropped.snapshot() | receiver.reception.sensors.dropped.snapshot(),
            routers=routers,
            frame=vehicle.frame or "",
            courses_refused=list(receiver.reception.refusals),
        )
    transport.close()
