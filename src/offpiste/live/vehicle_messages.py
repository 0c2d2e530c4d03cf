"""Readings of the vehicle from its messages, as its rig says what their numbers mean."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
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
from offpiste.core.errors import RigError
from offpiste.core.geometry import local_polynomial, rotation_of_one, yaw_rate_from_body_rates
from offpiste.logs.channel import KEPT_UP, convert, largest, to_z_up
from offpiste.logs.ros.bag_files import field_getter, heard_at
from offpiste.logs.ros.sensor_messages import joint_getter
from offpiste.logs.transforms import frame_pair
from offpiste.rig.channels import GEOGRAPHIC, ChannelSource
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import Given, VehicleReading
from offpiste.transport.tally import Tally

NO_STAMP: Final = "without a stamp of its own, and the robot's clock is not known yet"
"""Why a message is dropped that could only be stamped with its arrival."""
_KEPT: Final = 64
"""Samples of a channel that are kept, to differentiate those whose rates are not measured."""
_USED: Final = ("position", "orientation", "yaw", "linear_velocity", "angular_velocity", "yaw_rate")


@dataclass(frozen=True)
class _Source:
    """A channel of a topic: how its fields are read."""

    name: str
    entry: ChannelSource
    getters: tuple[Callable[[object], float], ...]


class VehicleMessages:
    """Assembles readings: one with each position, with the last values of all else.

    Args:
        rig: of the vehicle; its channels' topics are those of the robot.

    Attributes:
        topics: that are needed.
        position_topic: the one whose messages make readings.
        frame: of the poses, as its messages say; "" where they say none, as those of latitude and longitude, whose
            header names the antenna; None before the first.
        dropped: number of values that are not usable, by channel.

    Raises:
        RigError: the rig says something that only whole logs allow.
    """

    def __init__(self, rig: Rig) -> None:
        _refuse(rig)
        self._rig, self._kept = rig, dict[str, deque[tuple[float, np.ndarray]]]()
        self._geographic = rig.channels["position"].unit == GEOGRAPHIC
        self.dropped = Tally()
        names = (*_USED, *(a.channel for a in all_actuators()), *(c.name for c in KERNEL_CONTROLS))
        self._sources: dict[str, list[_Source]] = {}
        for name in names:
            if name in rig.channels:
                entry = rig.channels[name]
                named = zip(entry.fields, entry.joints, strict=True) if entry.joints else ()
                getters = tuple(joint_getter(*each) for each in named) or tuple(map(field_getter, entry.fields))
                source = _Source(name, entry, getters)
                self._sources.setdefault(entry.topic, []).append(source)
        self.position_topic = rig.channels["position"].topic
        self.topics = tuple(self._sources)
        self.frame: str | None = None

    def take(self, topic: str, message: Any, received: float) -> VehicleReading | None:
        """Add a message; a reading if it has the position, and enough else is known.

        Args:
            received: when it came by the robot's clock [s]; not finite before that is known.
        """
        stamp = heard_at(received, message, self._rig.clock.stamps)
        if not np.isfinite(stamp):
            self.dropped[f"{topic}: {'its header has no stamp' if np.isnan(stamp) else NO_STAMP}"] += 1
            return None
        if topic == self.position_topic:
            named = "" if self._geographic else getattr(getattr(message, "header", None), "frame_id", "")
            self.frame = str(named).lstrip("/")
        for source in self._sources.get(topic, ()):
            self._add(source, message, stamp)
        return self._reading() if topic == self.position_topic and self._fresh("position", np.inf) else None

    def given(self, now: float) -> Given:
        """What the vehicle was last given by whomever; no control where one that the rig has is not heard."""
        engaged = self._latest("gear", now)
        gear = None if engaged is None else float(engaged[0])
        values = [self._latest(control.name, now) for control in CONTROLS]
        given = [control.name for control in CONTROLS if control.name in self._rig.channels]
        if not given or any(self._latest(name, now) is None for name in given):
            return Given(None, gear)
        return Given(np.array([0.0 if value is None else float(value[0]) for value in values]), gear)

    def _add(self, source: _Source, message: Any, stamp: float) -> None:
        name, entry = source.name, source.entry
        if entry.joints and not {*entry.joints} & {*getattr(message, "name", entry.joints)}:
            return  # of another publisher of this topic
        try:
            raw = np.array([[float(get(message)) for get in source.getters]])
            values = convert(name, entry, raw, self._rig.vehicle)
        except (AttributeError, TypeError, ValueError, IndexError, OverflowError, RigError) as error:
            self.dropped[f"{name}: {str(error).splitlines()[0][:80]}"] += 1
            return
        if self._rig.motion.axes != "z up":
            values = to_z_up(name, entry, values, self._rig.motion.axes)
        with np.errstate(invalid="ignore"):
            usable = bool((np.abs(values) <= largest(name)).all())
            if entry.valid is not None:
                usable &= bool(((values >= entry.valid[0]) & (values <= entry.valid[1])).all())
        if name == "orientation":
            usable &= abs(float(np.linalg.norm(values)) - 1) < 0.05
        time = stamp - entry.delay
        kept = self._kept.setdefault(name, deque(maxlen=_KEPT))
        if not usable:
            self.dropped[f"{name}: not finite or not valid"] += 1
        elif not kept or time > kept[-1][0]:
            kept.append((time, values[0]))
        elif time < kept[-1][0]:  # the clock went back: what is kept is of another time
            kept.clear()
            kept.append((time, values[0]))

    def _reading(self) -> VehicleReading | None:
        time, position = self._kept["position"][-1]
        orientation = self._orientation(time)
        if orientation is None:
            return None
        velocity, rate = self._velocity(time, orientation), self._yaw_rate(time, orientation)
        if velocity is None or rate is None:
            return None
        actuators = np.array([self._actuator(one, time) for one in ACTUATORS])
        extra = {one.name: self._actuator(one, time) for one in registered_actuators()}
        place = np.append(position, 0.0) if len(position) == 2 else position
        return VehicleReading(time, place, orientation, velocity, rate, actuators, extra)

    def _orientation(self, time: float) -> Float[np.ndarray, " 4"] | None:
        if (given := self._latest("orientation", time)) is not None:
            return given
        yaw = self._latest("yaw", time)
        return None if yaw is None else np.array((0.0, 0.0, np.sin(yaw[0] / 2), np.cos(yaw[0] / 2)))

    def _velocity(self, time: float, orientation: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " 3"] | None:
        """Velocity of the pose point in the world frame; from positions where the log has none of its own."""
        entry = self._rig.channels.get("linear_velocity")
        if entry is None or entry.frame == "unknown":
            rate = self._rate("position", time)
            return None if rate is None else np.append(rate, 0.0) if len(rate) == 2 else rate
        given = self._latest("linear_velocity", time)
        if given is None:
            return None
        full = np.append(given, 0.0) if len(given) == 2 else given
        return full if entry.frame == "world" else rotation_of_one(orientation) @ full

    def _yaw_rate(self, time: float, orientation: Float[np.ndarray, " 4"]) -> float | None:
        if "yaw_rate" in self._rig.channels:
            given = self._latest("yaw_rate", time)
            return None if given is None else float(given[0])
        gyro = self._rig.channels.get("angular_velocity")
        if gyro is not None and gyro.frame == "body":
            given = self._latest("angular_velocity", time)
            return None if given is None else float(yaw_rate_from_body_rates(orientation[None], given[None])[0])
        name = "yaw" if "yaw" in self._rig.channels else "orientation"
        samples = list(self._kept.get(name, ()))
        turn = [value[0] if name == "yaw" else _yaw(value) for _, value in samples]
        rate = self._derivative(np.array([t for t, _ in samples]), np.unwrap(turn)[:, None], time)
        return None if rate is None else float(rate[0])

    def _actuator(self, actuator: Actuator, time: float) -> float:
        """Its last value; its derivative from what it is the rate of; NaN where neither is heard."""
        given = self._latest(actuator.channel, time)
        if given is not None:
            return float(given[0])
        measured = channel_of_rate(actuator.channel)
        if actuator.channel in self._rig.channels or measured not in self._rig.channels:
            return float("nan")
        rate = self._rate(measured, time)
        return float("nan") if rate is None else float(rate[0])

    def _rate(self, channel: str, time: float) -> Float[np.ndarray, " k"] | None:
        samples = list(self._kept.get(channel, ()))
        if not samples:
            return None
        if self._rig.channels[channel].interpolation == "on change":  # it is what it was last
            window = time - self._rig.motion.window * np.arange(KEPT_UP)[::-1] / KEPT_UP
            samples += [(at, samples[-1][1]) for at in window if at > samples[-1][0]]
        return self._derivative(np.array([t for t, _ in samples]), np.stack([v for _, v in samples]), time)

    def _derivative(
        self, time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"], at: float
    ) -> Float[np.ndarray, " k"] | None:
        if len(time) < 4:
            return None
        _, rate = local_polynomial(time, values, np.array([at]), window=self._rig.motion.window, causal=True)
        return rate[0] if np.isfinite(rate).all() else None

    def _latest(self, channel: str, time: float) -> Float[np.ndarray, " k"] | None:
        """Last value that is not older than the rig's largest gap."""
        return self._kept[channel][-1][1] if self._fresh(channel, time) else None

    def _fresh(self, channel: str, time: float) -> bool:
        kept = self._kept.get(channel)
        if not kept:
            return False
        stays = self._rig.channels[channel].interpolation == "on change"
        return stays or time == np.inf or abs(time - kept[-1][0]) <= self._rig.clock.max_gap


def _yaw(quaternion: Float[np.ndarray, " 4"]) -> float:
    forward = rotation_of_one(quaternion)[:, 0]
    return float(np.arctan2(forward[1], forward[0]))


def _refuse(rig: Rig) -> None:
    position = rig.channels["position"]
    if position.unit == GEOGRAPHIC and position.origin is None:
        how = "give channels.position.origin = [latitude, longitude] of a place near by: there x = y = 0"
        raise RigError("positions in degrees need an origin to be driven by", where="channels.position", how=how)
    for name, source in rig.channels.items():
        if frame_pair(source.topic) is not None:
            how = "have the robot publish it as nav_msgs/Odometry, and name that topic"
            raise RigError("transforms are read from logs only", where=f"channels.{name}.topic", how=how)
    if rig.alignment is not None:
        how = "synchronise the clocks, or give the delays"
        raise RigError("clocks that drift are aligned over whole logs only", where="alignment", how=how)
