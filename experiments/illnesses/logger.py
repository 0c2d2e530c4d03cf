"""A healthy recording of a true drive, by a logger drawn at random, with the rig that is right for it."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Float

from experiments.illnesses.recording import Case, Stream
from experiments.illnesses.sensing import POSE_SOURCES, START, PoseSource, Sensing, quantised
from experiments.illnesses.true_drive import TrueDrive
from offpiste.rig.channels import ChannelSource, undeclared, unit_factor
from offpiste.rig.rig import Motion, Rig, Vehicle, check_rig


@dataclass(frozen=True)
class Encoding:
    """How a quantity is written: the entries of its `ChannelSource`, and the smallest step of the recorded number."""

    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    sign: int = 1
    step: float = 0.0


_STEERING: Final = (
    Encoding(),
    Encoding(sign=-1),
    Encoding(unit="percent", step=0.1),
    Encoding(scale=1 / 400, offset=-1500 / 400, step=1.0),  # pulse width of a servo [us]
    Encoding(scale=1 / 450, sign=-1, step=0.1),  # degrees of the steering wheel, + right
)
_PEDAL: Final = (
    Encoding(),
    Encoding(step=1 / 255),
    Encoding(unit="percent", step=0.5),
    Encoding(scale=1 / 500, offset=-1500 / 500, step=1.0),
)
_ENCODINGS: Final[dict[str, tuple[Encoding, ...]]] = {
    "throttle": _PEDAL,
    "brake": _PEDAL,
    "steer": _STEERING,
    "steer_angle": (Encoding(), Encoding(unit="deg", step=0.05), Encoding(sign=-1), Encoding(unit="deg", sign=-1)),
    "steer_rate": (Encoding(),),
    "brake_pressure": (Encoding(), Encoding(scale=1e-7, step=1e3)),
    "engine_rpm": (Encoding(unit="rev/min", step=1.0), Encoding(unit="rad/s")),
    "wheel_speed": (Encoding(), Encoding(unit="km/h", step=0.01), Encoding(scale=0.35, step=0.001)),
    "yaw_rate": (Encoding(), Encoding(unit="deg/s", step=0.01), Encoding(sign=-1)),
    "yaw": (Encoding(), Encoding(unit="deg", step=0.01), Encoding(sign=-1)),
    "linear_velocity": (Encoding(), Encoding(), Encoding(unit="km/h")),
    "angular_velocity": (Encoding(), Encoding(), Encoding(unit="deg/s")),
    "position": (Encoding(), Encoding(step=0.001), Encoding(unit="mm", step=0.1)),
    "orientation": (Encoding(),),
}


_FASTEST_TABLE: Final = 500.0
"""Rows of a table are rarer than this [Hz]."""
_FASTEST_ENGINE: Final = 14_000.0
"""Electric motors of small cars turn faster, and no logger here records those [rev/min]."""


@dataclass
class _Topic:
    """A topic that is being put together.

    Attributes:
        time: moments of measurement [s since the start of the drive].
    """

    time: Float[np.ndarray, " n"]
    columns: dict[str, np.ndarray] = field(default_factory=dict)


class Logger:
    """Records a drive.

    Args:
        needs: channels that the recording has in any case; "topics" if it must not be one table, "position z" if
            positions have a height.
        random: random numbers of everything.
    """

    def __init__(self, drive: TrueDrive, random: np.random.Generator, needs: Collection[str] = ()) -> None:
        self.drive, self.random, self.needs = drive, random, needs
        forward = float(random.choice((0.0, -0.5, 0.1))) * drive.wheelbase
        self.pose_point = forward, float(random.choice((0.0, 0.2, 0.5))) * drive.wheelbase
        self.sensing = Sensing(drive, self.pose_point, random)
        fitting = [s for s in POSE_SOURCES.values() if s.sizes[0] <= drive.wheelbase <= s.sizes[1]]
        self.source: PoseSource = fitting[int(random.integers(len(fitting)))]
        self.jitter = float(random.choice((0.0, 0.01, 0.05)))
        self.rate = float(random.choice(self.source.rates))
        # A table of a thousand rows a second is rare, and slow.
        self.table = bool(random.random() < 0.3) and self.rate < _FASTEST_TABLE and "topics" not in needs
        self.topics: dict[str, _Topic] = {}
        self.channels: dict[str, ChannelSource] = {}

    def record(self) -> Case:
        """The recording and its rig."""
        self._pose()
        self._velocities()
        self._controls()
        self._actuators()
        rig = self._rig()
        check_rig(rig)
        streams = {}
        for name, topic in self.topics.items():
            if not topic.columns:
                continue
            stamps = START + topic.time
            streams[name] = Stream(stamps, None if self.table else self.sensing.arrivals(stamps), topic.columns)
        return Case(streams, rig)

    def _chance(self, share: float, *channels: str) -> bool:
        """Whether to record something: at random, unless a channel of it is needed."""
        return bool(self.random.random() < share) or bool(set(channels) & set(self.needs))

    @property
    def _brakes(self) -> bool:
        """Whether the brake is used at all: else its channel would look dead."""
        return bool(np.ptp(self.drive.command[:, 1]) > 0)

    def _topic(self, name: str, rates: Sequence[float]) -> str:
        """The topic for a group of channels, the one table where all share it."""
        name = "" if self.table else name
        if name not in self.topics:
            rate = self.rate if self.table or not rates else float(self.random.choice(rates))
            self.topics[name] = _Topic(self.sensing.stamps(rate, jitter=self.jitter))
        return name

    def _add(
        self, topic: str, channel: str, fields: Sequence[str], values: Float[np.ndarray, "n k"], **entries: str
    ) -> None:
        """Encode a channel into columns of a topic, and describe it in the rig."""
        choices = _ENCODINGS[channel]
        encoding = choices[int(self.random.integers(len(choices)))]
        written = encoding.sign * values / unit_factor(channel, encoding.unit)
        written = quantised((written - encoding.offset) / encoding.scale, encoding.step)
        self.topics[topic].columns |= dict(zip(fields, written.T.copy(), strict=True))
        source = {"unit": encoding.unit, "scale": encoding.scale, "offset": encoding.offset, "sign": encoding.sign}
        self.channels[channel] = ChannelSource(tuple(fields), topic, **source, **entries)  # type: ignore[arg-type]

    def _pose(self) -> None:
        topic = self._topic("odometry", ())
        time, source = self.topics[topic].time, self.source
        size = min(self.drive.wheelbase / 2, 1.0)
        noise = self.sensing.noise(time, 3, white=source.white * size, slow=source.wander * size)
        origins = ((0.0, 0.0, 0.0), (412_345.0, 5_312_345.0, 620.0), (-250.0, 130.0, 5.0))
        position = self.sensing.position(time) + noise + origins[int(self.random.integers(len(origins)))]
        planar = self.random.random() < 0.1 and "position z" not in self.needs
        self._add(topic, "position", ("x", "y") if planar else ("x", "y", "z"), position[:, : 2 if planar else 3])
        orientation = self.sensing.orientation(time, error=source.heading)
        if "orientation" in self.needs or ("yaw" not in self.needs and self.random.random() < 0.7):
            self._add(topic, "orientation", ("qx", "qy", "qz", "qw"), orientation)
        else:
            yaw = self.sensing.yaw(orientation)
            wrapped = (yaw + np.pi) % (2 * np.pi) - np.pi if self.random.random() < 0.7 else yaw
            self._add(topic, "yaw", ("yaw",), wrapped[:, None])

    def _velocities(self) -> None:
        speed = float(np.sqrt(self.drive.wheelbase / 2))
        if self._chance(0.6, "linear_velocity"):
            topic = self._topic("odometry", ())
            time = self.topics[topic].time
            frame = "body" if self.random.random() < 0.6 else "world"
            noise = self.sensing.noise(time, 3, white=0.02 * speed, slow=0.01 * speed)
            if "yaw" in self.channels:
                velocity = self._planar_velocity(time, frame) + noise[:, :2]
                self._add(topic, "linear_velocity", ("vx", "vy"), velocity, frame=frame)
            else:
                velocity = self.sensing.velocity(time, frame) + noise
                self._add(topic, "linear_velocity", ("vx", "vy", "vz"), velocity, frame=frame)
        if self._chance(0.6, "angular_velocity", "yaw_rate"):
            apart = self.random.random() < 0.5
            topic = self._topic("imu" if apart else "odometry", (50.0, 100.0, 200.0))
            time = self.topics[topic].time
            noise = self.sensing.noise(time, 3, white=0.005 / speed, slow=0.001)
            single = "yaw" in self.channels or "yaw_rate" in self.needs or self.random.random() < 0.3
            if single and "angular_velocity" not in self.needs:
                rate = self.sensing.yaw_rate(time)[:, None] + noise[:, :1]
                self._add(topic, "yaw_rate", ("yaw_rate",), rate)
            else:
                rates = self.sensing.body_rates(time) + noise
                self._add(topic, "angular_velocity", ("wx", "wy", "wz"), rates, frame="body")

    def _planar_velocity(self, time: Float[np.ndarray, " n"], frame: str) -> Float[np.ndarray, "n 2"]:
        """Horizontal velocity [m/s]; in the body's frame it is turned by minus yaw."""
        x, y, _ = self.sensing.velocity(time, "world").T
        if frame == "world":
            return np.stack((x, y), axis=1)
        yaw = self.sensing.yaw(self.sensing.orientation(time, error=0.0))
        return np.stack((np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x), axis=1)

    def _controls(self) -> None:
        together = self.random.random() < 0.5
        rates = (20.0, 50.0, 100.0)
        hold = {"interpolation": "hold"} if self.random.random() < 0.7 else {}
        pedals = self._topic("command" if together else "pedals", rates)
        time = self.topics[pedals].time
        if self._chance(0.97, "throttle"):
            self._add(pedals, "throttle", ("throttle",), self.sensing.commanded(0, time)[:, None], **hold)
        if self._chance(0.85 * self._brakes, "brake"):
            self._add(pedals, "brake", ("brake",), self.sensing.commanded(1, time)[:, None], **hold)
        if self._chance(0.9, "steer", "steer_angle"):
            topic = self._topic("command" if together else "steering_command", rates)
            steer = self.sensing.commanded(2, self.topics[topic].time)[:, None]
            self._add(topic, "steer", ("steer",), steer, **hold)
        else:
            # The measured angle stands for a command that was not recorded.
            topic = self._topic("steering", rates)
            angle = self.sensing.measured("steer_angle", self.topics[topic].time)
            self._add(topic, "steer", ("angle",), angle / self.drive.max_steer)

    def _actuators(self) -> None:
        rates = (20.0, 50.0, 100.0)
        if "steering" not in self.topics and self._chance(0.5, "steer_angle"):
            topic = self._topic("steering", rates)
            noisy = self._noisy("steer_angle", topic, 0.001)
            self._add(topic, "steer_angle", ("steering_angle",), noisy)
            if self._chance(0.3, "steer_rate"):
                self._add(topic, "steer_rate", ("steering_rate",), self._noisy("steer_rate", topic, 0.01))
        if self._chance(0.35, "wheel_speed"):
            topic = self._topic("wheels", rates)
            fields = ("front_left", "front_right", "rear_left", "rear_right")
            self._add(topic, "wheel_speed", fields, self._noisy("wheel_speed", topic, 0.03))
        if self._chance(0.3 * (self.drive.engine_speed.max() < _FASTEST_ENGINE), "engine_rpm"):
            topic = self._topic("engine", (10.0, 20.0, 50.0))
            self._add(topic, "engine_rpm", ("rpm",), self._noisy("engine_speed", topic, 10.0) / 1000)
        if self._chance(0.25 * self._brakes, "brake_pressure"):
            topic = self._topic("brakes", rates)
            self._add(topic, "brake_pressure", ("pressure",), self._noisy("brake_pressure", topic, 0.002))

    def _noisy(self, name: str, topic: str, size: float) -> Float[np.ndarray, "n k"]:
        values = self.sensing.measured(name, self.topics[topic].time)
        noisy: np.ndarray = values + size * self.random.standard_normal(values.shape)
        return noisy

    def _rig(self) -> Rig:
        drive, forward = self.drive, self.pose_point[0]
        front, rear, side = drive.wheelbase / 2 - forward, -drive.wheelbase / 2 - forward, drive.track / 2
        vehicle = Vehicle(
            mass=drive.mass,
            wheel_positions=((front, side), (front, -side), (rear, side), (rear, -side)),
            pose_point=f"{self.pose_point[0]:.2f} m ahead of the middle, {self.pose_point[1]:.2f} m up",
            max_steer=drive.max_steer,
            source="simulated",
        )
        # Five samples of the pose behind a velocity.
        motion = Motion(window=max(0.3, 5 / self.rate))
        absent = tuple(undeclared(self.channels))
        rig = Rig("logger", vehicle, self.channels, absent=absent, motion=motion)
        if self.table:
            clock = msgspec.structs.replace(rig.clock, column="time")
            rig = msgspec.structs.replace(rig, clock=clock)
        return rig


def recorded(drive: TrueDrive, random: np.random.Generator, needs: Collection[str] = ()) -> Case:
    """A healthy recording of a drive; see `Logger`."""
    return Logger(drive, random, needs).record()
