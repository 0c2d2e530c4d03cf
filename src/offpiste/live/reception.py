"""Reception of a robot's messages: readings, images, scans, the course, and the dead man's switch."""

import csv
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LiveError, OffpisteError, RigError
from offpiste.core.geometry import local_from_geographic
from offpiste.live.robot_messages import SensorMessages, VehicleMessages
from offpiste.logs.channel import FAR, to_z_up
from offpiste.logs.measurements import Cloud, Image
from offpiste.logs.ros.bag_files import field_getter, heard_at
from offpiste.planning.course import FASTEST, Course
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.transport.message_types import MessageTypes

_SETTLE: Final = 1.0
"""Time after the first reading at which silent optional sensors are left out [s]."""
_LONGEST: Final = 100_000
"""Maximum number of points of a course."""
_APART: Final = 0.05
"""Minimum distance between points of a course [m]; nearer ones are dropped."""


@dataclass(frozen=True)
class CourseRequest:
    """Source of the course: a file, a topic or a goal."""

    file: Path | None = None  # a table
    topic: str = ""  # of nav_msgs/Path; a new path replaces the course
    goal: tuple[float, float] | None = None  # x, y [m]
    speed: float = 3.0  # if the source gives none [m/s]

    def check(self) -> None:
        """Raise `LiveError` for none or several sources, and for an invalid speed or goal."""
        how = "give one of --course FILE.csv, --course-topic TOPIC and --goal X Y"
        if sum((self.file is not None, bool(self.topic), self.goal is not None)) != 1:
            raise LiveError("the course is missing, or given more than once", how=how)
        if not 0 < self.speed <= 30:
            raise LiveError(f"invalid desired speed {self.speed:g} m/s", how="give --speed above 0, and at most 30")
        if self.goal is not None and not np.isfinite(self.goal).all():
            raise LiveError("the goal is not finite", where="--goal", how="give metres in the frame of the poses")


@dataclass(frozen=True)
class Pressed:
    """Message of the dead man's switch."""

    pressed: bool | None  # None if it lacks the field
    age: float = 0.0  # by the robot's clock [s]; 0 without a stamp, not finite if either is invalid


Taken = VehicleReading | Image | Cloud | Course | Pressed


class Reception:
    """Convert a robot's messages.

    Args:
        request: source of the course.
        cameras: whether images are required.

    Attributes:
        vehicle: converter of vehicle messages.
        sensors: converter of camera and LiDAR messages.
        refusals: reasons for refusing the latest courses.

    Raises:
        LiveError, RigError: a setting, a file or the rig is invalid.
    """

    def __init__(self, rig: Rig, request: CourseRequest, *, cameras: bool) -> None:
        request.check()
        if not rig.lidars:
            raise LiveError(f"rig '{rig.name}' has no LiDAR", where="lidars", how="mapping the ground requires one")
        self._rig, self._request = rig, request
        self.vehicle, self.sensors = VehicleMessages(rig), SensorMessages(rig, cameras=cameras)
        self.course = None if request.file is None else read_course(request.file, request.speed, rig)
        self._first: float | None = None
        self._early: Any = None  # a path received before the frame of the poses is known
        self._enable_topic = "" if rig.live.enable is None else rig.live.enable.topic
        self.refusals: deque[str] = deque(maxlen=3)

    @property
    def topics(self) -> dict[str, bool]:
        """Required topics, and whether to request their last message."""
        found = dict.fromkeys((*self.vehicle.topics, *self.sensors.topics, self._enable_topic), False)
        found |= dict.fromkeys((*self._rig.frames.topics, self._request.topic), True)
        return {topic: kept for topic, kept in found.items() if topic}

    def type_of(self, topic: str) -> str:
        """Return a topic's message type if the rig states it or only one is possible; else ""."""
        known = dict.fromkeys(self._rig.frames.topics, "tf2_msgs/msg/TFMessage")
        known[self._request.topic] = "nav_msgs/msg/Path"
        return (known | self._rig.live.types).get(topic, "")

    @property
    def waiting_for(self) -> str:
        """Description of what is missing before driving can begin; empty if nothing is."""
        if self._first is None:
            return f"readings of the vehicle on {', '.join(self.vehicle.topics)}"
        if self.sensors.waiting_for:
            return self.sensors.waiting_for
        if self.course is not None:
            return ""
        return f"a course: {self.refusals[-1]}" if self.refusals else f"a course on {self._request.topic}"

    def take(self, topic: str, message: Any, received: float) -> list[Taken]:
        """Convert a message.

        Args:
            received: arrival by the robot's clock [s]; not finite while that is unknown.
        """
        taken: list[Taken | None] = []
        if topic == self._enable_topic:
            taken.append(switch_of(self._rig, message, received))
        if topic == self._request.topic:
            taken.append(self._new_course(message))
        if topic in self.vehicle.topics and (reading := self.vehicle.take(topic, message, received)) is not None:
            taken += [self._course_at(reading), reading]
        if topic in self.sensors.topics:
            taken.append(self.sensors.take(topic, message, received))
        return [one for one in taken if one is not None]

    def _course_at(self, reading: VehicleReading) -> Course | None:
        """Take note of a reading; return a course that it makes possible."""
        if self._first is None or reading.time < self._first:
            self._first = reading.time
        if reading.time - self._first > _SETTLE:
            self.sensors.settle()
        if self._early is not None:
            early, self._early = self._early, None
            return self._new_course(early)
        if self._request.goal is None or self.course is not None:
            return None
        try:
            ends = np.stack((reading.position[:2], np.array(self._request.goal)))
            self.course = _course(ends, np.full(2, self._request.speed), where="the goal")
        except LiveError as error:  # the vehicle is at the goal: wait until it is elsewhere
            if str(error) not in self.refusals:
                self.refusals.append(str(error))
        return self.course

    def _new_course(self, message: Any) -> Course | None:
        frame = self.vehicle.frame
        try:
            course = _course_from_path(message, self._request.speed, self._request.topic, frame or "")
        except (OffpisteError, AttributeError, TypeError, ValueError) as error:
            self.refusals.append(str(error))
            return None
        if frame is None:
            self._early = message
            return None
        old = self.course  # planners repeat their path
        if old is not None and np.array_equal(course.path, old.path) and np.array_equal(course.speed, old.speed):
            return None
        self.course = course
        return course


def read_course(path: Path, speed: float, rig: Rig) -> Course:
    """Read a course from a table with columns x, y [m] in the frame of the poses and, optionally, speed [m/s].

    Columns lat and lon [degrees] may replace x and y if the rig's position has an origin. Raises `LiveError`.
    """
    how = "give a .csv with a line 'x,y' or 'x,y,speed' first, in metres of the poses' frame, or 'lat,lon' in degrees"
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # Excel begins with a byte order mark
            rows = [row for _, row in zip(range(_LONGEST + 1), csv.DictReader(file), strict=False)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise LiveError(f"cannot read the course: {reason}", where=path, how=how) from error
    try:
        geographic = bool(rows) and "lat" in rows[0] and "x" not in rows[0]
        names = ("lat", "lon") if geographic else ("x", "y")
        places = np.array([[float(row[name]) for name in names] for row in rows]).reshape(-1, 2)
        has_speed = bool(rows) and rows[0].get("speed") not in (None, "")
        speeds = np.array([float(row["speed"]) for row in rows]) if has_speed else np.full(len(places), speed)
    except (KeyError, TypeError, ValueError) as error:
        raise LiveError(f"a row without a number: {error}", where=path, how=how) from error
    return _course(_local(places, rig, path) if geographic else places, speeds, where=str(path))


def _local(degrees: Float[np.ndarray, "P 2"], rig: Rig, path: Path) -> Float[np.ndarray, "P 2"]:
    """Convert latitudes and longitudes to the frame of the poses [m]."""
    position = rig.channels["position"]
    if position.origin is None:
        how = "give x and y in metres of the poses' frame; degrees need positions in 'lat lon' with an origin"
        raise LiveError(f"a course in degrees, and rig '{rig.name}' does not define an origin", where=path, how=how)
    places = to_z_up("position", position, local_from_geographic(degrees, position.origin), rig.motion.axes)
    if (away := float(np.abs(places).max(initial=0.0))) > FAR:
        how = "give latitude and longitude near the rig's origin, in these columns"
        raise LiveError(f"a point {away / 1e3:.0f} km from channels.position.origin", where=path, how=how)
    return places


def _course_from_path(message: Any, speed: float, topic: str, frame: str) -> Course:
    """Convert a nav_msgs/Path in the frame of the vehicle's poses ("" if that is unknown)."""
    given = str(message.header.frame_id).lstrip("/")
    if frame and given and given != frame:
        how = f"publish it in '{frame}'"
        raise LiveError(f"a path in '{given}', the vehicle's poses are in '{frame}'", where=f"topic '{topic}'", how=how)
    places = [(pose.pose.position.x, pose.pose.position.y) for pose in message.poses[: _LONGEST + 1]]
    xy = np.array(places, dtype=np.float64).reshape(-1, 2)
    return _course(xy, np.full(len(xy), speed), where=f"topic '{topic}'")


def _course(xy: Float[np.ndarray, "P 2"], speed: Float[np.ndarray, " P"], *, where: str) -> Course:
    """Check the points of a course and drop repeated ones."""
    if len(xy) > _LONGEST:
        raise LiveError(f"a course of more than {_LONGEST} points", where=where, how="reduce its points")
    if not np.isfinite(xy).all() or not ((speed > 0) & (speed <= FASTEST)).all():
        how = f"give finite metres, and speeds above 0 and at most {FASTEST:g} m/s"
        raise LiveError("a point of the course, or its speed, is invalid", where=where, how=how)
    keep = [0] if len(xy) else []
    for k in range(1, len(xy)):
        if np.linalg.norm(xy[k] - xy[keep[-1]]) >= _APART:
            keep.append(k)
    if len(keep) < 2:
        raise LiveError("the course has fewer than two distinct points", where=where, how="give at least two points")
    return Course(xy[keep], speed[keep])


def switch_of(rig: Rig, message: Any, received: float) -> Pressed:
    """Convert a message of the dead man's switch (`received` as in `Reception.take`)."""
    assert rig.live.enable is not None
    pressed = is_pressed(rig.live.enable.field, message)
    return Pressed(pressed, received - heard_at(received, message, rig.clock.stamps))


def is_pressed(field: str, message: Any) -> bool | None:
    """Return whether the dead man's switch is pressed; None if its message lacks the field."""
    try:
        return float(field_getter(field)(message)) > 0.5
    except (AttributeError, TypeError, ValueError):
        return None


def check_types(rig: Rig, types: MessageTypes) -> None:
    """Raise `RigError` for an unknown message type in [live.types] or a missing field of the dead man's switch."""
    for topic, msgtype in rig.live.types.items():
        if msgtype not in types:
            how = "give the file of its definition in live.definitions"
            raise RigError(f"message type {msgtype} is unknown", where=f'live.types."{topic}"', how=how)
    enable = rig.live.enable
    msgtype = "" if enable is None else rig.live.types.get(enable.topic, "")
    if enable is not None and msgtype and is_pressed(enable.field, types.empty(msgtype)) is None:
        how = f"give the path of a number or boolean of {msgtype}"
        raise RigError(f"the type has no field '{enable.field}'", where="live.enable.field", how=how)
