"""A robot's messages as the run time takes them: readings, images, scans, courses, and the dead man's switch."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from offpiste.core.errors import LiveError, OffpisteError, RigError
from offpiste.live.course import course_from_message, course_to, is_same_course, read_course
from offpiste.live.sensor_messages import SensorMessages
from offpiste.live.vehicle_messages import VehicleMessages
from offpiste.logs.measurements import Cloud, Image
from offpiste.logs.ros.bag_files import field_getter, heard_at
from offpiste.planning.course import Course
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.transport.message_types import MessageTypes

COURSE = "nav_msgs/msg/Path"
"""Type of a course that comes as a message."""
SETTLE = 1.0
"""Time after the first reading, at which sensors that are optional and were not heard are left out [s]."""


@dataclass(frozen=True)
class CourseRequest:
    """Where the course comes from: one of the three.

    Attributes:
        file: a table.
        topic: of nav_msgs/Path; another one replaces the course.
        goal: x, y [m].
        speed: where they give none [m/s].
    """

    file: Path | None = None
    topic: str = ""
    goal: tuple[float, float] | None = None
    speed: float = 3.0

    def check(self) -> None:
        """Refuse none and several.

        Raises:
            LiveError: which is wrong.
        """
        how = "give one of --course FILE.csv, --course-topic TOPIC and --goal X Y"
        if sum((self.file is not None, bool(self.topic), self.goal is not None)) != 1:
            raise LiveError("there is no course, or more than one", how=how)
        if not 0 < self.speed <= 30:
            raise LiveError(f"a wanted speed of {self.speed:g} m/s", how="give --speed above 0, and at most 30")
        if self.goal is not None and not np.isfinite(self.goal).all():
            raise LiveError("the goal is no place", where="--goal", how="give metres in the frame of the poses")


@dataclass(frozen=True)
class Pressed:
    """A message of the dead man's switch.

    Attributes:
        pressed: None where it has no such field.
        age: time since its stamp by the robot's clock [s]; 0 without a stamp, not finite where either is no time.
    """

    pressed: bool | None
    age: float = 0.0


Taken = VehicleReading | Image | Cloud | Course | Pressed
"""What a message can be to the run time."""


class Reception:
    """Takes messages.

    Args:
        rig: of the vehicle.
        request: of the course.
        cameras: whether images are needed.

    Attributes:
        vehicle: reads the vehicle's messages.
        sensors: reads cameras and LiDARs.
        refusals: why the last courses were refused.

    Raises:
        LiveError, RigError: a setting, a file or the rig is wrong.
    """

    def __init__(self, rig: Rig, request: CourseRequest, *, cameras: bool) -> None:
        request.check()
        if not rig.lidars:
            raise LiveError(f"rig '{rig.name}' has no LiDAR", where="lidars", how="a map of the ground needs one")
        self._rig, self._request = rig, request
        self.vehicle, self.sensors = VehicleMessages(rig), SensorMessages(rig, cameras=cameras)
        self.course = None if request.file is None else read_course(request.file, request.speed, rig)
        self._first: float | None = None
        self._early: Any = None  # a course that came before the frame of the poses is known
        enable = rig.live.enable
        self._enable_topic = "" if enable is None else enable.topic
        self.refusals: deque[str] = deque(maxlen=3)

    @property
    def topics(self) -> dict[str, bool]:
        """Topics that are needed, and whether messages before ours are asked for."""
        found = dict.fromkeys((*self.vehicle.topics, *self.sensors.topics), False)
        found |= dict.fromkeys(self._rig.frames.topics, True)
        if self._request.topic:
            found[self._request.topic] = True
        if self._enable_topic:
            found[self._enable_topic] = False
        return found

    def type_of(self, topic: str) -> str:
        """Message type of a topic, where the rig gives it or it can be but one; else empty."""
        known = dict.fromkeys(self._rig.frames.topics, "tf2_msgs/msg/TFMessage") | {self._request.topic: COURSE}
        return (known | self._rig.live.types).get(topic, "")

    @property
    def waiting_for(self) -> str:
        """What is missing before driving can begin, in words; empty once nothing is."""
        if self._first is None:
            return f"readings of the vehicle on {', '.join(self.vehicle.topics)}"
        if self.sensors.waiting_for:
            return self.sensors.waiting_for
        if self.course is not None:
            return ""
        return f"a course: {self.refusals[-1]}" if self.refusals else f"a course on {self._request.topic}"

    def take(self, topic: str, message: Any, received: float) -> list[Taken]:
        """What a message is.

        Args:
            received: when it came by the robot's clock [s]; not finite before that is known.
        """
        taken: list[Taken] = []
        if topic == self._enable_topic:
            taken.append(read_switch(self._rig, message, received))
        if topic == self._request.topic:
            taken += self._new_course(message)
        if topic in self.vehicle.topics and (reading := self.vehicle.take(topic, message, received)) is not None:
            taken += self._reading(reading)
        measured = self.sensors.take(topic, message, received) if topic in self.sensors.topics else None
        return taken if measured is None else [*taken, measured]

    def _reading(self, reading: VehicleReading) -> list[Taken]:
        if self._first is None or reading.time < self._first:
            self._first = reading.time
        if reading.time - self._first > SETTLE:
            self.sensors.settle()
        if self._early is not None:
            early, self._early = self._early, None
            return [*self._new_course(early), reading]
        if self._request.goal is None or self.course is not None:
            return [reading]
        try:
            self.course = course_to(np.array(self._request.goal), reading.position[:2], self._request.speed)
        except LiveError as error:  # it is there already: the goal is one once it is not
            if str(error) not in self.refusals:
                self.refusals.append(str(error))
            return [reading]
        return [self.course, reading]

    def _new_course(self, message: Any) -> list[Taken]:
        frame = self.vehicle.frame
        try:
            course = course_from_message(message, self._request.speed, self._request.topic, frame or "")
        except (OffpisteError, AttributeError, TypeError, ValueError) as error:
            self.refusals.append(str(error))
            return []
        if frame is None:
            self._early = message
            return []
        if self.course is not None and is_same_course(course, self.course):  # planners repeat it
            return []
        self.course = course
        return [course]


def read_switch(rig: Rig, message: Any, received: float) -> Pressed:
    """A message of a rig's dead man's switch.

    Args:
        received: when it came by the robot's clock [s]; not finite before that is known.
    """
    assert rig.live.enable is not None
    pressed = is_pressed(field_getter(rig.live.enable.field), message)
    return Pressed(pressed, received - heard_at(received, message, rig.clock.stamps))


def is_pressed(get: Callable[[object], float], message: Any) -> bool | None:
    """Whether a dead man's switch is pressed; None where its message has no such field.

    Args:
        get: reads `rig.outputs.Enable.field`.
    """
    try:
        return float(get(message)) > 0.5
    except (AttributeError, TypeError, ValueError):
        return None


def check_types(rig: Rig, types: MessageTypes) -> None:
    """Refuse message types of [live.types] that are not known, and a dead man's switch without its field.

    Raises:
        RigError: which.
    """
    for topic, msgtype in rig.live.types.items():
        if msgtype not in types:
            how = "give the file of its definition in live.definitions"
            raise RigError(f"message type {msgtype} is not known", where=f'live.types."{topic}"', how=how)
    enable = rig.live.enable
    msgtype = "" if enable is None else rig.live.types.get(enable.topic, "")
    if enable is not None and msgtype and is_pressed(field_getter(enable.field), types.empty(msgtype)) is None:
        how = f"give the path of a number or boolean of {msgtype}"
        raise RigError(f"'{enable.field}' is no such field", where="live.enable.field", how=how)
