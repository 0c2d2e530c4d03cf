"""Receives and decodes: readings at once, of images and scans the newest."""

import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from offpiste.core.errors import LiveError
from offpiste.live.backlog import Backlog
from offpiste.live.packing import pack_course, pack_measured, pack_sensors
from offpiste.live.part import RUNS_ON, STAMP, Part, keep_loaded
from offpiste.live.reception import Reception
from offpiste.live.session import Session
from offpiste.logs.measurements import Cloud, Image
from offpiste.planning.course import Course
from offpiste.rig.rig import load_rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.transport.interface import Received

CLOCK = "/clock"
DEAF: Final = 5.0
"""Where nothing has come for so long, the connection is made anew [s]: its thread may have ended for want of memory."""
_WAITING: Final = 256
"""Readings that may wait to be decoded; the same number of calibrations and transforms may wait beside."""


class Receiver:
    """Hands on what is received; images and scans are decoded in a thread beside the readings'."""

    def __init__(self, part: Part, *, cameras: bool) -> None:
        self.part, self.rig = part, load_rig(part.settings.rig)
        self.reception = Reception(self.rig, part.settings.course, cameras=cameras)
        definitions = [Path(name) for name in self.rig.live.definitions]
        self.transport = part.settings.robot.connect(definitions)
        self._small, self._calibrations = Backlog(_WAITING, part.dropped), Backlog(_WAITING, part.dropped)
        self._newest: dict[str, Received] = {}
        self._stamp, self._heard_at = -1.0, np.inf
        clock = part.settings.clock  # what has no header is stamped with its arrival, by the clock of all that has one
        self._by_robot, self._sets_clock = clock != "system", ""
        if clock == "stamps":
            self._sets_clock = self.reception.vehicle.position_topic
        self._lock, self._any, self._handed_over = threading.Lock(), threading.Event(), False
        self._measured = self.reception.sensors.measured
        for topic, history in self.reception.topics.items():
            msgtype = self.reception.type_of(topic)
            self.transport.subscribe(topic, self._deliver, msgtype=msgtype, history=history)
        if part.settings.clock == "clock":
            self.transport.subscribe(CLOCK, self._small.put, msgtype="rosgraph_msgs/msg/Clock")
        if self.reception.course is not None:
            self._course(self.reception.course)
        self._sensing = threading.Thread(target=self._sense, daemon=True)
        self._sensing.start()

    @property
    def state(self) -> str:
        """What it waits for and what was refused meanwhile, or that it is ready."""
        if waits := self.reception.waiting_for:
            return "; ".join((f"waits for {waits}", *(f"refused: {what}" for what in self._refused())))
        late = ", ".join(self.reception.sensors.left_out)
        return f"ready, without {late}: optional, and first heard once the others were set up" if late else "ready"

    def _refused(self) -> list[str]:
        """The most frequent refusals of the transport, by topic and reason."""
        refused = self.transport.refused.snapshot()
        return sorted(refused, key=lambda what: -refused[what])[:3]

    def _deliver(self, received: Received) -> None:
        """Called in zenoh's thread."""
        self._heard_at = received.steady
        if self._by_robot and received.topic != self._sets_clock:
            with self._lock:
                received = replace(received, received=self.part.now())
        if received.topic in self._measured:
            with self._lock:
                if received.topic in self._newest:
                    self.part.dropped.add(f"{received.topic}: replaced by a newer one")
                self._newest[received.topic] = received
            self._any.set()
        elif received.topic in self.reception.sensors.topics and self.reception.sensors.sensors is None:
            self._calibrations.put(received)
            self._any.set()
        if received.topic not in self.reception.sensors.topics or received.topic in self.reception.vehicle.topics:
            self._small.put(received)

    def read(self) -> None:
        """Decode and hand on readings, courses and the clock, as many as may wait; wait a moment for the first."""
        received, most = self._small.get(0.05), _WAITING  # more may come meanwhile, and signs of life are due
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
                if self.part.settings.clock == "stamps":
                    self._clock(taken.time, received.steady)
                given = self.reception.vehicle.given(taken.time)
                self.part.hand_on("readings", pack_measured(taken, **given._asdict(), came=received.steady))
            elif isinstance(taken, Course):
                self._course(taken)

    def _clock(self, stamp: float, steady: float) -> None:
        """Hand on the clock; a stamp that repeats is no sign that it runs."""
        if stamp != self._stamp:
            if self._stamp >= 0 and not -RUNS_ON <= stamp - self._stamp <= RUNS_ON:
                self.part.dropped.add("the clock jumped")
            self._stamp = stamp
            self.part.hand_on("clock", STAMP.pack(stamp, steady))

    def _course(self, course: Course) -> None:
        """Hand on a course, unless it is the one that is being driven, as mostly after a restart."""
        newest, data = self.part.ring("course").newest(), pack_course(course)
        if newest is None or newest.data != data:
            self.part.hand_on("course", data)

    def check(self) -> None:
        """End what no longer receives or decodes: it is started again.

        Raises:
            LiveError: why.
        """
        if self.part.ending:
            return
        if not self._sensing.is_alive():
            raise LiveError("images and scans are not decoded any more", how="see what it said before")
        if self.transport.routers() and time.monotonic() - self._heard_at > DEAF:
            raise LiveError(f"nothing has been heard for {DEAF:g} s", how="see whether the robot still publishes")

    def _sense(self) -> None:
        """Decode images and scans, the newest of each sensor."""
        while not self.part.ending:
            self._any.wait(0.1)
            self._any.clear()
            waiting = list(iter(partial(self._calibrations.get, 0.0), None))
            with self._lock:
                newest, self._newest = self._newest, {}
            for received in (*waiting, *newest.values()):
                message = self.transport.decode(received)
                taken = message and self.reception.sensors.take(received.topic, message, received.received)
                if isinstance(taken, Image):
                    self.part.hand_on("images", pack_measured(taken))
                elif isinstance(taken, Cloud):
                    self.part.hand_on("scans", pack_measured(taken))
            if self.reception.sensors.sensors is not None and not self._handed_over:
                self._handed_over = self.part.ring("sensors").write(pack_sensors(self.reception.sensors.sensors))


def receive(session: Session, *, cameras: bool) -> None:
    """The process that receives."""
    part = Part("receive", session)
    receiver, connected = Receiver(part, cameras=cameras), True
    keep_loaded()
    while not part.ended:  # control needs readings until the vehicle is at a standstill
        receiver.read()
        receiver.check()
        routers = receiver.transport.routers()
        part.dropped.add("connection to the router lost", connected and not routers)
        connected = routers > 0
        part.beat(
            receiver.state if routers else "no router: nothing is heard or sent",
            refused=receiver.transport.refused.snapshot(),
            unusable=receiver.reception.vehicle.dropped.snapshot() | receiver.reception.sensors.dropped.snapshot(),
            routers=routers,
            frame=receiver.reception.vehicle.frame or "",
            courses_refused=list(receiver.reception.refusals),
        )
    receiver.transport.close()
