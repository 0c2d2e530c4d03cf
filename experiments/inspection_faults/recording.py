"""A recording in memory and the rig through which it is read, and a random healthy recording of a true drive."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from experiments.inspection_faults.drives import TrueDrive
from offpiste.core.geometry import (
    planar_body_from_world,
    rotation_from_quaternion,
    same_sign,
    yaw_from_quaternion,
    yaw_rate_from_body_rates,
)
from offpiste.logs.channel import convert
from offpiste.logs.log import Log, Samples, Topic
from offpiste.rig.channels import SECONDS_PER_UNIT, ChannelSource, Clock, undeclared, unit_factor
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Motion, Rig, Vehicle, check_rig

START: Final = 1_750_000_000.0
"""Stamp of the start of a drive [s]."""


@dataclass(frozen=True)
class Stream:
    """Samples of one topic, in the order of the file; arrival is None where the format does not keep it."""

    time: Float[np.ndarray, " n"]  # stamps [s]
    arrival: Float[np.ndarray, " n"] | None  # [s]
    columns: dict[str, Float[np.ndarray, " n"]]


class RecordingLog(Log):
    """A log of streams in memory."""

    description = "a recording in memory"
    has_clock_unit = True

    def __init__(self, streams: dict[str, Stream], clock: Clock) -> None:
        self.path, self._streams, self._clock = Path("recording"), streams, clock

    @property
    def topics(self) -> dict[str, Topic]:
        """One topic per stream."""
        return {name: Topic(name, "memory", len(s.time), tuple(s.columns)) for name, s in self._streams.items()}

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        stream = self._streams[topic.name]
        stamped = stream.time * SECONDS_PER_UNIT[self._clock.unit]
        time = stream.arrival if stamps == "receive" and stream.arrival is not None else stamped
        return Samples(time, np.column_stack([stream.columns[field] for field in fields]))

    @property
    def clock(self) -> Clock:
        """The unit of the stamps, by the rig."""
        return Clock(unit=self._clock.unit)


@dataclass(frozen=True)
class Case:
    """Streams by topic and the rig that reads them; faults change one, the other, or both."""

    streams: dict[str, Stream]
    rig: Rig

    @property
    def log(self) -> Log:
        """The recording as a log."""
        return RecordingLog(self.streams, self.rig.clock)

    def has(self, channel: str) -> bool:
        """Whether the rig has this channel."""
        return channel in self.rig.channels

    def source(self, channel: str) -> ChannelSource:
        """Where the rig reads a channel."""
        return self.rig.channels[channel]

    def stream(self, channel: str) -> Stream:
        """The topic that a channel is read from."""
        return self.streams[self.source(channel).topic]

    def values(self, channel: str) -> Float[np.ndarray, "n k"]:
        """A channel as the rig converts it."""
        columns = self.stream(channel).columns
        raw = np.column_stack([columns[field] for field in self.source(channel).fields])
        return convert(channel, self.source(channel), raw, self.rig.vehicle)

    def with_raw(self, channel: str, raw: Float[np.ndarray, "n k"]) -> "Case":
        """The case with other recorded numbers in a channel's fields."""
        source, stream = self.source(channel), self.stream(channel)
        columns = stream.columns | dict(zip(source.fields, raw.T.copy(), strict=True))
        return self.with_stream(source.topic, replace(stream, columns=columns))

    def with_values(self, channel: str, values: Float[np.ndarray, "n k"]) -> "Case":
        """The case with recorded numbers that the rig converts to these values."""
        return self.with_raw(channel, _encoded(channel, self.source(channel), values))

    def with_stream(self, topic: str, stream: Stream) -> "Case":
        """The case with another stream for a topic."""
        return replace(self, streams={**self.streams, topic: stream})

    def with_rows(self, topic: str, keep: np.ndarray) -> "Case":
        """The case with some rows of a topic, by a mask or by row numbers in any order."""
        stream = self.streams[topic]
        arrival = None if stream.arrival is None else stream.arrival[keep]
        columns = {name: column[keep] for name, column in stream.columns.items()}
        return self.with_stream(topic, Stream(stream.time[keep], arrival, columns))

    def with_stamps(self, topic: str, time: Float[np.ndarray, " n"]) -> "Case":
        """The case with other stamps of a topic; times of arrival stay."""
        return self.with_stream(topic, replace(self.streams[topic], time=time))

    def with_rig(self, *entries: tuple[str, object]) -> "Case":
        """The case with some entries of the rig set."""
        return replace(self, rig=edited(self.rig, [Edit(key, value) for key, value in entries]))


def _encoded(channel: str, source: ChannelSource, values: np.ndarray) -> np.ndarray:
    return np.asarray((source.sign * values / unit_factor(channel, source.unit) - source.offset) / source.scale)


_PLAIN: Final[dict[str, Any]] = {}
_PEDAL: Final = (_PLAIN, {"step": 1 / 255}, {"unit": "percent", "step": 0.5},
                 {"scale": 1 / 500, "offset": -3.0, "step": 1.0})  # fmt: skip
_ENCODINGS: Final[dict[str, tuple[dict[str, Any], ...]]] = {
    "throttle": _PEDAL,
    "brake": _PEDAL,
    # The last two: the pulse width of a servo [us], and degrees of the steering wheel, + right.
    "steer": (_PLAIN, {"sign": -1}, {"unit": "percent", "step": 0.1},
              {"scale": 1 / 400, "offset": -3.75, "step": 1.0}, {"scale": 1 / 450, "sign": -1, "step": 0.1}),
    "steer_angle": (_PLAIN, {"unit": "deg", "step": 0.05}, {"sign": -1}, {"unit": "deg", "sign": -1}),
    "brake_pressure": (_PLAIN, {"scale": 1e-7, "step": 1e3}),
    "engine_rpm": ({"unit": "rev/min", "step": 1.0}, {"unit": "rad/s"}),
    "wheel_speed": (_PLAIN, {"unit": "km/h", "step": 0.01}, {"scale": 0.35, "step": 0.001}),
    "yaw_rate": (_PLAIN, {"unit": "deg/s", "step": 0.01}, {"sign": -1}),
    "yaw": (_PLAIN, {"unit": "deg", "step": 0.01}, {"sign": -1}),
    "linear_velocity": (_PLAIN, _PLAIN, {"unit": "km/h"}),
    "angular_velocity": (_PLAIN, _PLAIN, {"unit": "deg/s"}),
    "position": (_PLAIN, {"step": 0.001}, {"unit": "mm", "step": 0.1}),
}  # fmt: skip
"""How a quantity may be written: entries of its `ChannelSource`, and the smallest step of the recorded number."""


@dataclass(frozen=True)
class _PoseSource:
    """Typical errors of a source of poses, from data sheets and papers."""

    rates: tuple[float, ...]  # [Hz]
    white: float  # noise of each position [m]
    wander: float  # slow error of the position with a correlation time of 20 s [m]
    heading: float  # noise of each heading, half of it slow [rad]
    sizes: tuple[float, float]  # smallest and largest wheelbase of the vehicles that carry it [m]


_POSE_SOURCES: Final = (
    _PoseSource((20.0, 50.0, 100.0, 200.0), 0.002, 0.03, 0.002, (0.8, 10.0)),  # GNSS/INS
    _PoseSource((10.0,), 0.01, 0.01, 0.004, (0.8, 10.0)),  # RTK at a low rate
    _PoseSource((10.0, 20.0), 0.01, 0.05, 0.003, (0.3, 10.0)),  # LiDAR SLAM
    _PoseSource((30.0, 100.0, 200.0), 0.002, 0.1, 0.002, (0.15, 10.0)),  # visual-inertial odometry
    _PoseSource((100.0, 120.0, 240.0, 1000.0), 0.0003, 0.0005, 0.001, (0.0, 0.6)),  # motion capture
)
_ORIGINS: Final = ((0.0, 0.0, 0.0), (412_345.0, 5_312_345.0, 620.0), (-250.0, 130.0, 5.0))
_RATES: Final = (20.0, 50.0, 100.0)
_ACTUATORS: Final = (
    ("steering", 0.4, "steer_angle", ("steering_angle",), "steer_angle", 1.0, 0.001),
    ("steering", 0.15, "steer_rate", ("steering_rate",), "steer_rate", 1.0, 0.01),
    ("wheels", 0.35, "wheel_speed", ("front_left", "front_right", "rear_left", "rear_right"), "wheel_speed", 1.0, 0.03),
    ("engine", 0.3, "engine_rpm", ("rpm",), "engine_speed", 1e-3, 0.01),
    ("brakes", 0.25, "brake_pressure", ("pressure",), "brake_pressure", 1.0, 0.002),
)
"""Topic, share of the recordings, channel, fields, attribute of the drive, factor, noise."""
_FASTEST_TABLE, _FASTEST_ENGINE = 500.0, 14_000.0
"""Rows of a table per second, and engine speed [rev/min], above which loggers do not record them."""


class _Recorder:
    """Samples a drive with random rates, encodings and noise, and collects topics and channels."""

    def __init__(self, drive: TrueDrive, random: np.random.Generator, needs: Collection[str]) -> None:
        self.drive, self.random, self.needs = drive, random, needs
        self.forward = float(random.choice((0.0, -0.5, 0.1))) * drive.wheelbase
        self.up = float(random.choice((0.0, 0.2, 0.5))) * drive.wheelbase
        arm = np.array((self.forward, 0.0, self.up))
        rotation, spin = rotation_from_quaternion(drive.orientation), np.cross(drive.angular_velocity, arm)
        self._position = CubicSpline(drive.time, drive.position + rotation @ arm)
        self._velocity = CubicSpline(drive.time, drive.velocity + np.einsum("nij,nj->ni", rotation, spin))
        self._orientation = CubicSpline(drive.time, same_sign(drive.orientation))
        self._rates = CubicSpline(drive.time, drive.angular_velocity)
        fitting = [source for source in _POSE_SOURCES if source.sizes[0] <= drive.wheelbase <= source.sizes[1]]
        self.source = fitting[int(random.integers(len(fitting)))]
        self.jitter, self.rate = float(random.choice((0.0, 0.01, 0.05))), float(random.choice(self.source.rates))
        self.table = bool(random.random() < 0.3) and self.rate < _FASTEST_TABLE and "topics" not in needs
        self.times: dict[str, np.ndarray] = {}
        self.columns: dict[str, dict[str, np.ndarray]] = {}
        self.channels: dict[str, ChannelSource] = {}

    def chance(self, share: float, *channels: str) -> bool:
        """Whether to record something: at random, unless one of its channels is needed."""
        return bool(self.random.random() < share) or bool({*channels} & {*self.needs})

    def topic(self, name: str, rates: Sequence[float] = ()) -> tuple[str, Float[np.ndarray, " n"]]:
        """The name and the times [s since the start] of a topic, or of the one table."""
        name = "" if self.table else name
        if name not in self.times:
            rate = self.rate if self.table or not rates else float(self.random.choice(rates))
            first = self.random.uniform(0, min(1 / rate, 0.2))
            count = int((self.drive.seconds - first) * rate * 0.999)
            even = first + np.arange(count) / (rate * self.random.uniform(0.999, 1.001))
            moved = even + np.clip(self.jitter * self.random.standard_normal(count), -0.4, 0.4) / rate
            self.times[name], self.columns[name] = np.clip(moved, 0.0, self.drive.seconds), {}
        return name, self.times[name]

    def add(self, topic: str, channel: str, fields: Sequence[str], values: np.ndarray, **entries: Any) -> None:
        """Encode a channel into columns of a topic, and describe it in the rig."""
        choices = _ENCODINGS.get(channel, (_PLAIN,))
        encoding = dict(choices[int(self.random.integers(len(choices)))])
        step = encoding.pop("step", 0.0)
        source = ChannelSource(tuple(fields), topic, **encoding, **entries)
        written = _encoded(channel, source, values.reshape(len(values), -1))
        written = np.round(written / step) * step if step else written
        self.columns[topic] |= dict(zip(fields, written.T.copy(), strict=True))
        self.channels[channel] = source

    def noise(self, time: np.ndarray, width: int, white: float, slow: float) -> Float[np.ndarray, "n k"]:
        """White noise, and slow noise with a correlation time of 20 s."""
        knots = np.arange(-20.0, self.drive.seconds + 60.0, 20.0)
        wander = CubicSpline(knots, self.random.standard_normal((len(knots), width)))(time)
        return np.asarray(white * self.random.standard_normal((len(time), width)) + slow * wander)

    def pose(self) -> None:
        """Positions with a height or without, and headings as quaternions or angles."""
        (topic, time), source = self.topic("odometry"), self.source
        size = min(self.drive.wheelbase / 2, 1.0)
        position = self._position(time) + self.noise(time, 3, source.white * size, source.wander * size)
        position += _ORIGINS[int(self.random.integers(len(_ORIGINS)))]
        width = 2 if self.random.random() < 0.1 and "position z" not in self.needs else 3
        self.add(topic, "position", ("x", "y", "z")[:width], position[:, :width])
        turn = Rotation.from_rotvec(self.noise(time, 3, source.heading / 2, source.heading / 2))
        orientation = (Rotation.from_quat(self._orientation(time)) * turn).as_quat()
        if "orientation" in self.needs or ("yaw" not in self.needs and self.random.random() < 0.7):
            self.add(topic, "orientation", ("qx", "qy", "qz", "qw"), orientation)
        else:
            yaw = yaw_from_quaternion(orientation)
            self.add(topic, "yaw", ("yaw",), (yaw + np.pi) % (2 * np.pi) - np.pi if self.random.random() < 0.7 else yaw)

    def velocities(self) -> None:
        """Velocities of the pose point and turn rates, in three dimensions or in the plane."""
        speed, planar = float(np.sqrt(self.drive.wheelbase / 2)), "yaw" in self.channels
        if self.chance(0.6, "linear_velocity"):
            topic, time = self.topic("odometry")
            frame, true = (
                ("body" if self.random.random() < 0.6 else "world"),
                Rotation.from_quat(self._orientation(time)),
            )
            velocity = self._velocity(time)
            if frame == "body" and planar:
                yaw = yaw_from_quaternion(true.as_quat())
                velocity = np.column_stack((planar_body_from_world(velocity[:, :2], yaw), velocity[:, 2]))
            elif frame == "body":
                velocity = true.apply(velocity, inverse=True)
            velocity = (velocity + self.noise(time, 3, 0.02 * speed, 0.01 * speed))[:, : 2 if planar else 3]
            self.add(topic, "linear_velocity", ("vx", "vy", "vz")[: velocity.shape[1]], velocity, frame=frame)
        if self.chance(0.6, "angular_velocity", "yaw_rate"):
            apart = self.random.random() < 0.5
            topic, time = self.topic("imu", (50.0, 100.0, 200.0)) if apart else self.topic("odometry")
            noise = self.noise(time, 3, 0.005 / speed, 0.001)
            single = planar or "yaw_rate" in self.needs or self.random.random() < 0.3
            if single and "angular_velocity" not in self.needs:
                rate = yaw_rate_from_body_rates(self._orientation(time), self._rates(time))
                self.add(topic, "yaw_rate", ("yaw_rate",), rate + noise[:, 0])
            else:
                self.add(topic, "angular_velocity", ("wx", "wy", "wz"), self._rates(time) + noise, frame="body")

    def controls(self) -> None:
        """Commands, held from each time on; in some recordings the measured angle stands for a steering command."""
        drive, together = self.drive, self.random.random() < 0.5
        hold = {"interpolation": "hold"} if self.random.random() < 0.7 else {}
        commanded = {
            "throttle": self.chance(0.97, "throttle"),
            "brake": self.chance(0.85 * (np.ptp(drive.command[:, 1]) > 0), "brake"),
            "steer": self.chance(0.9, "steer", "steer_angle"),
        }
        for index, (channel, present) in enumerate(commanded.items()):
            if present:
                apart = "steering_command" if channel == "steer" else "pedals"
                topic, time = self.topic("command" if together else apart, _RATES)
                row = np.maximum(np.searchsorted(drive.time, time, side="right") - 1, 0)
                self.add(topic, channel, (channel,), drive.command[row, index], **hold)
        if not commanded["steer"]:
            topic, time = self.topic("steering", _RATES)
            angle = np.interp(time, drive.time, drive.steer_angle)
            self.add(topic, "steer", ("angle",), angle / drive.max_steer)

    def actuators(self) -> None:
        """Measured channels of the vehicle."""
        drive, copied = self.drive, "steering" in self.times
        for name, share, channel, fields, attribute, factor, noise in _ACTUATORS:
            idle = channel == "brake_pressure" and np.ptp(drive.command[:, 1]) == 0
            fast = channel == "engine_rpm" and drive.engine_speed.max() > _FASTEST_ENGINE
            if self.chance(share * (not (idle or fast)), channel) and not (copied and name == "steering"):
                topic, time = self.topic(name, (10.0, 20.0, 50.0) if name == "engine" else _RATES)
                true = getattr(drive, attribute).reshape(len(drive.time), -1).T
                values = factor * np.stack([np.interp(time, drive.time, column) for column in true], axis=1)
                self.add(topic, channel, fields, values + noise * self.random.standard_normal(values.shape))

    def case(self) -> Case:
        """The recording and its rig."""
        drive = self.drive
        front, rear, side = drive.wheelbase / 2 - self.forward, -drive.wheelbase / 2 - self.forward, drive.track / 2
        vehicle = Vehicle(
            mass=drive.mass,
            wheel_positions=((front, side), (front, -side), (rear, side), (rear, -side)),
            pose_point=f"{self.forward:.2f} m ahead of the middle, {self.up:.2f} m up",
            max_steer=drive.max_steer,
            source="simulated",
        )
        motion = Motion(window=max(0.3, 5 / self.rate))  # five poses per velocity
        rig = Rig("logger", vehicle, self.channels, absent=tuple(undeclared(self.channels)), motion=motion)
        if self.table:
            rig = msgspec.structs.replace(rig, clock=msgspec.structs.replace(rig.clock, column="time"))
        check_rig(rig)
        streams = {
            name: Stream(START + self.times[name], None if self.table else self._arrivals(name), columns)
            for name, columns in self.columns.items()
            if columns
        }
        return Case(streams, rig)

    def _arrivals(self, topic: str) -> Float[np.ndarray, " n"]:
        """Times of arrival after some milliseconds of transport, in order [s]."""
        stamps, latency = START + self.times[topic], self.random.uniform(0.001, 0.02)
        late = stamps + latency + self.random.exponential(0.2 * latency, len(stamps))
        return np.maximum.accumulate(late)


def recorded(drive: TrueDrive, random: np.random.Generator, needs: Collection[str] = ()) -> Case:
    """Return a healthy recording of a drive and the rig that is right for it.

    Args:
        needs: channels that must be recorded; "topics" if it must not be one table, "position z" for a height.
    """
    recorder = _Recorder(drive, random, needs)
    for part in (recorder.pose, recorder.velocities, recorder.controls, recorder.actuators):
        part()
    return recorder.case()
