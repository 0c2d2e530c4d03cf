"""Receives and decodes: readings at once, of images and scans the newest."""

import queue
import threading
import time
from pathlib import Path

from offpiste.live.packing import pack_course, pack_measured, pack_sensors
from offpiste.live.part import STAMP, Part
from offpiste.live.reception import Reception
from offpiste.live.session import Session
from offpiste.logs.measurements import Cloud, Image
from offpiste.planning.course import Course
from offpiste.rig.rig import load_rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.transport.interface import Received

CLOCK = "/clock"


class Receiver:
    """Hands on what is received; images and scans are decoded in a thread beside the readings'."""

    def __init__(self, part: Part, *, cameras: bool) -> None:
        self.part, self.rig = part, load_rig(part.settings.rig)
        self.reception = Reception(self.rig, part.settings.course, cameras=cameras)
        definitions = [Path(name) for name in self.rig.live.definitions]
        self.transport = part.settings.robot.connect(definitions)
        self._small: queue.SimpleQueue[Received] = queue.SimpleQueue()
        self._newest: dict[str, Received] = {}
        self._calibrations: queue.SimpleQueue[Received] = queue.SimpleQueue()
        self._lock, self._any, self._handed_over = threading.Lock(), threading.Event(), False
        measured = {*(c.topic for c in self.rig.cameras.values()), *(one.topic for one in self.rig.lidars.values())}
        self._measured = measured & set(self.reception.sensors.topics)
        types = self.rig.live.types
        for topic, history in self.reception.topics.items():
            self.transport.subscribe(topic, self._deliver, msgtype=types.get(topic, ""), history=history)
        if part.settings.clock == "clock":
            self.transport.subscribe(CLOCK, self._small.put, msgtype="rosgraph_msgs/msg/Clock")
        if self.reception.course is not None:
            part.ring("course").write(pack_course(self.reception.course))
        threading.Thread(target=self._sense, daemon=True).start()

    def _deliver(self, received: Received) -> None:
        """Called in zenoh's thread."""
        if received.topic in self._measured:
            with self._lock:
                if received.topic in self._newest:
                    self.part.dropped[f"{received.topic}: replaced by a newer one"] += 1
                self._newest[received.topic] = received
            self._any.set()
        elif received.topic in self.reception.sensors.topics:
            self._calibrations.put(received)
            self._any.set()
        if received.topic not in self.reception.sensors.topics or received.topic in self.reception.vehicle.topics:
            self._small.put(received)

    def read(self) -> None:
        """Decode and hand on readings, courses and the clock, for as long as there are any, or a moment."""
        try:
            received = self._small.get(timeout=0.05)
        except queue.Empty:
            return
        message = self.transport.decode(received)
        if message is None:
            return
        if received.topic == CLOCK:
            self._clock(message.clock.sec + message.clock.nanosec / 1e9)
            return
        for taken in self.reception.take(received.topic, message, received.received):
            if isinstance(taken, VehicleReading):
                if self.part.settings.clock == "stamps":
                    self._clock(taken.time)
                control = self.reception.vehicle.control(taken.time)
                self.part.ring("readings").write(pack_measured(taken, control=control))
            elif isinstance(taken, Course):
                self.part.ring("course").write(pack_course(taken))

    def _clock(self, stamp: float) -> None:
        self.part.ring("clock").write(STAMP.pack(stamp, time.monotonic()))

    def _sense(self) -> None:
        """Decode images and scans, the newest of each sensor."""
        while not self.part.ending:
            self._any.wait(0.1)
            self._any.clear()
            with self._lock:
                waiting, self._newest = list(self._newest.values()), {}
            while not self._calibrations.empty():
                waiting.insert(0, self._calibrations.get())
            for received in waiting:
                message = self.transport.decode(received)
                taken = message and self.reception.sensors.take(received.topic, message, received.received)
                if isinstance(taken, Image):
                    self.part.ring("images").write(pack_measured(taken))
                elif isinstance(taken, Cloud):
                    self.part.ring("scans").write(pack_measured(taken))
            if self.reception.sensors.sensors is not None and not self._handed_over:
                self._handed_over = self.part.ring("sensors").write(pack_sensors(self.reception.sensors.sensors))


def receive(session: Session, *, cameras: bool) -> None:
    """The process that receives."""
    part = Part("receive", session)
    receiver = Receiver(part, cameras=cameras)
    while not part.ending:
        receiver.read()
        dropped = receiver.reception.vehicle.dropped + receiver.reception.sensors.dropped + part.dropped
        waits = receiver.reception.waiting_for
        part.beat(
            f"waits for {waits}" if waits else "ready",
            refused=dict(receiver.transport.refused),
            unusable=dict(dropped),
            routers=receiver.transport.routers(),
            courses_refused=receiver.reception.refusals[-3:],
        )
    receiver.transport.close()
