"""Readings, images and scans from the messages of a robot, as described by its rig."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import (
    ACTUATORS,
    CONTROLS,
    KERNEL_CONTROLS,
    Actuator,
    all_actuators,
    channel_of_rate,
    registered_actuators,
)
from offpiste.core.errors import LogError, PerceptionError, RigError
from offpiste.core.geometry import local_polynomial, rotation_of_one, yaw_from_quaternion, yaw_rate_from_body_rates
from offpiste.logs.channel import KEPT_UP, convert, largest, to_z_up
from offpiste.logs.log import Log, RawCloud, Samples, Topic
from offpiste.logs.measurements import (
    Camera,
    Cloud,
    Image,
    Lidar,
    camera_of,
    cloud_from_records,
    in_eight_bits,
    lidar_of,
    refuse_rough,
)
from offpiste.logs.ros.bag_files import field_getter, heard_at
from offpiste.logs.ros.image_encodings import pixels_of
from offpiste.logs.ros.sensor_messages import joint_getter, points_from_message
from offpiste.logs.transforms import Transform, frame_pair, transform_of
from offpiste.rig.camera import CameraModel, model_from_message
from offpiste.rig.channels import GEOGRAPHIC, ChannelSource
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import CameraSource, LidarSource
from offpiste.runtime.estimator import Given, VehicleReading
from offpiste.transport.received import Tally

_NO_STAMP: Final = "without a header stamp before the robot's clock is known"
_KEPT: Final = 64
"""Number of samples kept per channel, to differentiate channels whose rates are not measured."""
_USED: Final = ("position", "orientation", "yaw", "linear_velocity", "angular_velocity", "yaw_rate")
Sensors = tuple[dict[str, Camera], dict[str, Lidar]]
"""Cameras and LiDARs by name."""
_Source = tuple[str, ChannelSource, tuple[Callable[[object], float], ...]]
"""Name and entry of a channel, and the getters of its fields."""


class VehicleMessages:
    """Assemble a reading from each position message and the latest values of the other channels.

    Attributes:
        topics: required topics.
        position_topic: topic whose messages complete readings.
        frame: frame of the poses in their messages; "" if they state none or are geographic (their header names the
            antenna); None before the first message.
        dropped: number of unusable values, by channel and reason.

    Raises:
        RigError: the rig needs processing that only complete logs allow.
    """

    def __init__(self, rig: Rig) -> None:
        _refuse(rig)
        self._rig, self._kept = rig, dict[str, deque[tuple[float, np.ndarray]]]()
        self._geographic = rig.channels["position"].unit == GEOGRAPHIC
        self.dropped = Tally()
        names = (*_USED, *(a.channel for a in all_actuators()), *(c.name for c in KERNEL_CONTROLS))
        self._sources: dict[str, list[_Source]] = {}
        for name in names:
            if (entry := rig.channels.get(name)) is not None:
                named = zip(entry.fields, entry.joints, strict=True) if entry.joints else ()
                getters = tuple(joint_getter(*each) for each in named) or tuple(map(field_getter, entry.fields))
                self._sources.setdefault(entry.topic, []).append((name, entry, getters))
        self.position_topic = rig.channels["position"].topic
        self.topics = tuple(self._sources)
        self.frame: str | None = None

    def take(self, topic: str, message: Any, received: float) -> VehicleReading | None:
        """Add a message; return a reading if it has the position and enough channels are known.

        Args:
            received: arrival by the robot's clock [s]; not finite while that is unknown.
        """
        stamp = heard_at(received, message, self._rig.clock.stamps)
        if not np.isfinite(stamp):
            self.dropped[f"{topic}: {'its header has no stamp' if np.isnan(stamp) else _NO_STAMP}"] += 1
            return None
        for source in self._sources.get(topic, ()):
            self._add(source, message, stamp)
        if topic != self.position_topic:
            return None
        named = "" if self._geographic else getattr(getattr(message, "header", None), "frame_id", "")
        self.frame = str(named).lstrip("/")
        return self._reading()

    def given(self, now: float) -> Given:
        """Return the commands that the vehicle last received from any source; none if a channel of them is silent."""
        gear = self._value("gear", now)
        values = {one.name: self._value(one.name, now) for one in CONTROLS if one.name in self._rig.channels}
        if not values or None in values.values():
            return Given(None, gear)
        return Given(np.array([values.get(control.name, 0.0) for control in CONTROLS]), gear)

    def _add(self, source: _Source, message: Any, stamp: float) -> None:
        name, entry, getters = source
        if entry.joints and not {*entry.joints} & {*getattr(message, "name", entry.joints)}:
            return  # from another publisher of this topic
        try:
            raw = np.array([[float(get(message)) for get in getters]])
            values = convert(name, entry, raw, self._rig.vehicle)
        except (AttributeError, TypeError, ValueError, IndexError, OverflowError, RigError) as error:
            self.dropped[f"{name}: {str(error).splitlines()[0][:80]}"] += 1
            return
        value, (low, high) = to_z_up(name, entry, values, self._rig.motion.axes)[0], entry.valid or (-np.inf, np.inf)
        usable = np.isfinite(value) & (np.abs(value) <= largest(name)) & (value >= low) & (value <= high)
        if not usable.all() or (name == "orientation" and abs(np.linalg.norm(value) - 1) >= 0.05):
            self.dropped[f"{name}: not finite or not valid"] += 1
            return
        time, kept = stamp - entry.delay, self._kept.setdefault(name, deque(maxlen=_KEPT))
        if kept and time < kept[-1][0]:  # the clock went back: kept samples are obsolete
            kept.clear()
        if not kept or time > kept[-1][0]:
            kept.append((time, value))

    def _reading(self) -> VehicleReading | None:
        if not self._kept.get("position"):
            return None
        time, position = self._kept["position"][-1]
        orientation, yaw = self._latest("orientation", time), self._value("yaw", time)
        if orientation is None and yaw is not None:
            orientation = np.array((0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)))
        if orientation is None:
            return None
        velocity, rate = self._velocity(time, orientation), self._yaw_rate(time, orientation)
        if velocity is None or rate is None:
            return None
        actuators = np.array([self._actuator(one, time) for one in ACTUATORS])
        extra = {one.name: self._actuator(one, time) for one in registered_actuators()}
        return VehicleReading(time, _in_space(position), orientation, velocity, rate, actuators, extra)

    def _velocity(self, time: float, orientation: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " 3"] | None:
        """Return the world velocity of the pose point, by differentiating positions if the rig has no velocity."""
        entry = self._rig.channels.get("linear_velocity")
        measured = entry is not None and entry.frame != "unknown"
        given = self._latest("linear_velocity", time) if measured else self._rate("position", time)
        if given is None:
            return None
        in_body = measured and entry is not None and entry.frame != "world"
        return rotation_of_one(orientation) @ _in_space(given) if in_body else _in_space(given)

    def _yaw_rate(self, time: float, orientation: Float[np.ndarray, " 4"]) -> float | None:
        if "yaw_rate" in self._rig.channels:
            return self._value("yaw_rate", time)
        gyro = self._rig.channels.get("angular_velocity")
        if gyro is not None and gyro.frame == "body":
            given = self._latest("angular_velocity", time)
            return None if given is None else float(yaw_rate_from_body_rates(orientation[None], given[None])[0])
        rate = self._rate("yaw" if "yaw" in self._rig.channels else "orientation", time)
        return None if rate is None else float(rate[0])

    def _actuator(self, actuator: Actuator, time: float) -> float:
        """Return its last value, or the derivative of the channel that it is the rate of; NaN without either."""
        given = self._value(actuator.channel, time)
        measured = channel_of_rate(actuator.channel)
        if given is not None or actuator.channel in self._rig.channels or measured not in self._rig.channels:
            return float("nan") if given is None else given
        rate = self._rate(measured, time)
        return float("nan") if rate is None else float(rate[0])

    def _rate(self, channel: str, time: float) -> Float[np.ndarray, " k"] | None:
        """Return the derivative of a channel at `time` [s], in its unit per second; None if it is unknown.

        For an orientation, it is that of the yaw angle [rad/s].
        """
        samples, window = list(self._kept.get(channel, ())), self._rig.motion.window
        if samples and self._rig.channels[channel].interpolation == "on change":  # the last value holds
            later = time - window * np.arange(KEPT_UP)[::-1] / KEPT_UP
            samples += [(at, samples[-1][1]) for at in later if at > samples[-1][0]]
        if len(samples) < 4:
            return None
        times, values = (np.array(column) for column in zip(*samples, strict=True))
        if channel in ("yaw", "orientation"):
            values = np.unwrap(values, axis=0) if channel == "yaw" else yaw_from_quaternion(values)[:, None]
        _, rate = local_polynomial(times, values, np.array([time]), window=window, causal=True)
        return rate[0] if np.isfinite(rate).all() else None

    def _value(self, channel: str, time: float) -> float | None:
        """Return the last number of a channel, as `_latest`."""
        latest = self._latest(channel, time)
        return None if latest is None else float(latest[0])

    def _latest(self, channel: str, time: float) -> Float[np.ndarray, " k"] | None:
        """Return the last value unless it is older than the rig's maximum gap."""
        if not (kept := self._kept.get(channel)):
            return None
        stays = self._rig.channels[channel].interpolation == "on change"
        return kept[-1][1] if stays or abs(time - kept[-1][0]) <= self._rig.clock.max_gap else None


def _in_space(vector: Float[np.ndarray, " k"]) -> Float[np.ndarray, " 3"]:
    return np.append(vector, 0.0) if len(vector) == 2 else vector


def _refuse(rig: Rig) -> None:
    position = rig.channels["position"]
    if position.unit == GEOGRAPHIC and position.origin is None:
        how = "give channels.position.origin = [latitude, longitude] of a nearby point, where x = y = 0"
        raise RigError("driving by positions in degrees needs an origin", where="channels.position", how=how)
    for name, source in rig.channels.items():
        if frame_pair(source.topic) is not None:
            how = "publish the pose as nav_msgs/Odometry, and name that topic"
            raise RigError("transforms are read from logs only", where=f"channels.{name}.topic", how=how)
    if rig.alignment is not None:
        how = "synchronise the clocks, or give the delays"
        raise RigError("drifting clocks can only be aligned in complete logs", where="alignment", how=how)


class _HeardLog(Log):
    """Calibrations, frames and transforms received so far, as a log."""

    description = "messages of a robot"
    has_sensors = True

    def __init__(self) -> None:
        self.path = Path("the robot")
        self.last: dict[str, Any] = {}
        self._transforms: dict[tuple[str, str], Transform] = {}

    def hear(self, topic: str, message: Any, *, is_transforms: bool) -> None:
        """Keep the last message of each topic, as an earlier one may be unusable, and the last of each transform."""
        if is_transforms:
            for transform in map(transform_of, message.transforms):
                self._transforms[transform.parent, transform.child] = transform
        self.last[topic] = message

    @property
    def topics(self) -> dict[str, Topic]:
        """Received topics."""
        return {name: Topic(name, message.__msgtype__, 1, ()) for name, message in self.last.items()}

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        raise LogError("channels are read as they arrive", where=self.path)

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Return the transforms of all topics."""
        return list(self._transforms.values())

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Return the calibration in the topic's last CameraInfo."""
        return model_from_message(self.last[topic], topic, rectified=rectified)

    def frame(self, topic: str) -> str:
        """Return the frame in the last message's header."""
        return str(self.last[topic].header.frame_id).lstrip("/")


class SensorMessages:
    """Convert messages to images and scans, once the required calibrations have arrived.

    Args:
        cameras: whether images are required.

    Attributes:
        topics: required topics.
        measured: those of images and scans.
        dropped: number of unusable messages, by sensor and reason.
        left_out: optional sensors whose first message came after the setup of the others.
    """

    def __init__(self, rig: Rig, *, cameras: bool) -> None:
        self._rig, self._log = rig, _HeardLog()
        self._cameras = dict(rig.cameras) if cameras else {}
        self._entries: dict[str, CameraSource | LidarSource] = {**self._cameras, **rig.lidars}
        self._of = {entry.topic: name for name, entry in self._entries.items()}
        infos = [camera.info for camera in self._cameras.values() if camera.info]
        self.topics, self.measured = (*self._of, *infos, *rig.frames.topics), frozenset(self._of)
        self.dropped = Tally()
        self.sensors: Sensors | None = None
        self.left_out: list[str] = []
        self._why: dict[str, str] = {}
        self._lock = threading.Lock()  # `take` and `settle` are called by different threads

    @property
    def waiting_for(self) -> str:
        """Description of what is missing before images and scans can be used; empty if nothing is."""
        if self.sensors is not None:
            return ""
        silent = [entry.topic for entry in self._entries.values() if entry.topic not in self._log.last]
        heard = f"messages on {', '.join(silent)}" if silent else ""
        return "; ".join(text for text in (*self._why.values(), heard) if text) or "the first messages of its sensors"

    def take(self, topic: str, message: Any, received: float) -> Image | Cloud | None:
        """Add a message; return its image or scan if usable."""
        try:
            return self._take(topic, message, received)
        except Exception as error:  # noqa: BLE001 - fields of outside messages make NumPy and OpenCV raise anything
            reason = f"{type(error).__name__}: {error}".splitlines()[0][:100]
            self.dropped.add(f"{self._of.get(topic, topic)}: {reason}")
            return None

    def _take(self, topic: str, message: Any, received: float) -> Image | Cloud | None:
        name = self._of.get(topic)
        with self._lock:
            if self.sensors is None:
                self._log.hear(topic, message, is_transforms=topic in self._rig.frames.topics)
                self._set_up(complete=False)
        if name is None or self.sensors is None:
            return None
        cameras, lidars = self.sensors
        time = heard_at(received, message, self._rig.clock.stamps)
        if not np.isfinite(time):
            self.dropped.add(f"{name}: {_NO_STAMP}")
            return None
        if name in cameras:
            return self._image(cameras[name], topic, message, time)
        if name in lidars:
            return self._cloud(lidars[name], message, time)
        if name not in self.left_out:
            self.left_out.append(name)
        return None

    def settle(self) -> None:
        """Set up the sensors heard so far if only optional ones are missing."""
        with self._lock:
            if self.sensors is None:
                self._set_up(complete=True)

    def _set_up(self, *, complete: bool) -> None:
        """Set up all sensors; if `complete`, without the silent optional ones."""
        cameras, lidars = dict[str, Camera](), dict[str, Lidar]()
        transforms, why, missing = self._log.transforms(()), dict[str, str](), False
        for name, entry in self._entries.items():
            if entry.topic not in self._log.last:
                missing |= not (entry.optional and complete)
                continue
            try:
                refuse_rough(self._log, {name: entry})
                if name in self._cameras:
                    cameras[name] = camera_of(self._log, self._rig, name, self._cameras[name], transforms)
                else:
                    lidars[name] = lidar_of(self._log, self._rig, name, self._rig.lidars[name], transforms)
            except (LogError, PerceptionError) as error:
                why[name] = str(error)
            except Exception as error:  # noqa: BLE001 - see `take`
                why[name] = f"{name}: its messages are of another kind ({type(error).__name__})"
        self._why = why
        if not missing and not why and lidars:
            self.sensors = cameras, lidars

    def _image(self, camera: Camera, topic: str, message: Any, time: float) -> Image | None:
        pixels = pixels_of(message, topic)
        if pixels is None or (pixels.shape[1], pixels.shape[0]) != (camera.model.width, camera.model.height):
            self.dropped.add(f"{camera.name}: images that cannot be decoded or differ in size from the calibration")
            return None
        return Image(time - camera.source.delay, camera.name, in_eight_bits(pixels, camera))

    def _cloud(self, lidar: Lidar, message: Any, time: float) -> Cloud | None:
        cloud = cloud_from_records(RawCloud(time, lidar.name, points_from_message(message)), lidar)
        if not len(cloud.points):
            self.dropped.add(f"{lidar.name}: clouds without a usable point")
            return None
        return cloud
