"""Estimates of the vehicle over the last seconds: rows at 50 Hz for planning, poses for mapping."""

from collections import Counter, deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import actuator_columns
from offpiste.core.conventions import ACTUATORS, DT, HISTORY_STEPS
from offpiste.core.geometry import yaw_from_quaternion
from offpiste.dataset.columns import COLUMNS
from offpiste.dataset.resample import OWN_COLUMNS
from offpiste.logs.channel import Channel
from offpiste.logs.motion import extrapolated, planar_state
from offpiste.logs.poses import Poses
from offpiste.rig.outputs import Timeouts

JUMP = 1.0
"""Distance between a pose and its prediction above which it counts as a jump [m]."""

GAP = 0.25
"""Longest interval over which poses are interpolated [s]."""


@dataclass(frozen=True)
class VehicleReading:
    """Measured state and actuators of the vehicle."""

    time: float  # stamp [s]
    position: Float[np.ndarray, " 3"]  # of the pose point in the world frame [m]
    orientation: Float[np.ndarray, " 4"]  # world_from_body, xyzw
    velocity: Float[np.ndarray, " 3"]  # of the pose point in the world frame [m/s]
    yaw_rate: float  # d(yaw)/dt [rad/s]
    actuators: Float[np.ndarray, " A"]  # `conventions.ACTUATORS`; NaN if not measured
    extra: Mapping[str, float] = field(default_factory=dict)  # of extensions: actuators and `dataset.columns.COLUMNS`

    def measured(self, actuators: Sequence[str]) -> Float[np.ndarray, " A"]:
        """Return the values of actuators by name; NaN if not measured."""
        known = {**dict(zip(ACTUATORS, self.actuators, strict=True)), **self.extra}
        return np.array([known.get(name, np.nan) for name in actuators], np.float64)

    @property
    def finite(self) -> bool:
        """True if time, pose and velocities are finite and the orientation is not zero."""
        known = np.concatenate(([self.time, self.yaw_rate], self.position, self.orientation, self.velocity))
        return bool(np.isfinite(known).all() and np.abs(self.orientation).max() > 0)


class Given(NamedTuple):
    """Control (throttle, brake, steer) and gear from another driver, if received."""

    control: Float[np.ndarray, " 3"] | None = None
    gear: float | None = None

    def instead_of(self, control: Float[np.ndarray, " 3"], gear: float) -> tuple[Float[np.ndarray, " 3"], float]:
        """Return the control and gear of the other driver, or the given ones if not received."""
        return control if self.control is None else self.control, gear if self.gear is None else self.gear


@dataclass(frozen=True)
class TrackRows:
    """Rows t-10 ... t of the vehicle at intervals of `conventions.DT`, estimated causally."""

    state: Float[np.ndarray, "H 6"]  # `conventions.STATE`, in the world frame, yaw unwrapped
    actuators: Float[np.ndarray, "H A"]  # `conventions.ACTUATORS` and the registered actuators of the model
    control: Float[np.ndarray, "H 3"]  # `conventions.CONTROL`; not yet known in row t
    gear: Float[np.ndarray, " H"]  # engaged gear, 1 forward, -1 reverse; NaN before the first command
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)  # columns of extensions; NaN if missing


class VehicleTrack:
    """Buffer of the readings and commands of the last seconds.

    Args:
        seconds: length of the buffer [s].
        slowest: longest regular interval between readings [s]; poses are interpolated over it, or over `GAP`.
        actuators: actuators read by the model.
    """

    def __init__(self, *, seconds: float = 3.0, slowest: float = 0.0, actuators: Collection[str] = ()) -> None:
        self._columns = tuple(actuator.name for actuator in actuator_columns(actuators))
        self._seconds, self._max_gap = seconds, max(slowest, GAP)
        self._readings: deque[VehicleReading] = deque()
        self._commands: deque[tuple[float, np.ndarray, float]] = deque()

    @property
    def latest(self) -> VehicleReading | None:
        """Last reading; None before the first."""
        return self._readings[-1] if self._readings else None

    @property
    def enough(self) -> bool:
        """True if there are at least two poses, as interpolation requires."""
        return len(self._readings) >= 2

    def add(self, reading: VehicleReading) -> bool:
        """Add a reading, and return whether the pose jumped, which invalidates the map."""
        before = self.latest or reading
        expected = before.position + before.velocity * (reading.time - before.time)
        if jumped := bool(np.linalg.norm(reading.position - expected) > JUMP):
            self._readings.clear()
        self._readings.append(reading)
        while self._readings[0].time < reading.time - self._seconds:
            self._readings.popleft()
        return jumped

    def clear(self) -> None:
        """Delete all readings and commands."""
        self._readings.clear()
        self._commands.clear()

    def commanded(self, time: float, control: Float[np.ndarray, " 3"], gear: float = 1.0) -> None:
        """Record the control and gear (1 forward, -1 reverse) commanded from `time` [s] on."""
        while self._commands and self._commands[-1][0] >= time:  # the clock stopped or went back
            self._commands.pop()
        self._commands.append((time, control, gear))
        while self._commands[0][0] < time - self._seconds:
            self._commands.popleft()

    def poses(self) -> Poses:
        """Return the poses of the last seconds."""
        time, *pose = (
            np.array([getattr(r, name) for r in self._readings]) for name in ("time", "position", "orientation")
        )
        return Poses(Channel("position", "m", time, pose[0]), Channel("orientation", "1", time, pose[1]), self._max_gap)

    def awaits(self, time: float) -> bool:
        """Return whether a time [s] is later than all readings, so that its pose may still become known."""
        latest = self.latest
        return latest is not None and latest.time < time

    def pose_at(self, time: float) -> Float[np.ndarray, "4 4"] | None:
        """Return `world_from_body` at a time [s]; None if unknown."""
        if not self.enough:
            return None
        pose = self.poses().at(np.array([time]))[0]
        return None if np.isnan(pose).any() else np.asarray(pose)

    def rows(self, now: float) -> TrackRows:
        """Return the rows of the last 0.2 s up to `now` [s]; the first reading is repeated before it."""
        time = np.array([r.time for r in self._readings])
        at = now - DT * np.arange(HISTORY_STEPS, -1, -1)
        index = np.clip(np.searchsorted(time, at + 1e-6, side="right") - 1, 0, len(time) - 1)
        chosen = [self._readings[int(i)] for i in index]
        age = np.maximum(at - time[index], 0.0)
        velocity = np.stack([r.velocity[:2] for r in chosen])
        rate = np.array([[r.yaw_rate] for r in chosen])
        yaw = yaw_from_quaternion(np.stack([r.orientation for r in chosen]))
        yaw = extrapolated(yaw[:, None], rate, age)
        place = extrapolated(np.stack([r.position[:2] for r in chosen]), velocity, age)
        state = planar_state(place, yaw, velocity, rate)
        past = [name for name, column in COLUMNS.items() if name not in OWN_COLUMNS and "past" in column.segments]
        extra = {name: np.array([r.extra.get(name, np.nan) for r in chosen]) for name in past}
        return TrackRows(state, np.stack([r.measured(self._columns) for r in chosen]), *self.controls(at), extra)

    def controls(self, at: Float[np.ndarray, " N"]) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, " N"]]:
        """Return controls and gears at times [s]; 0 and NaN before the first command, the last one is held."""
        if not self._commands:
            return np.zeros((len(at), 3)), np.full(len(at), np.nan)
        time, control, gear = (np.stack(column) for column in zip(*self._commands, strict=True))
        index = np.searchsorted(time, at + 1e-6, side="right") - 1
        known, held = index >= 0, np.maximum(index, 0)
        return np.where(known[:, None], control[held], 0.0), np.where(known, gear[held], np.nan)


class Intake:
    """Checks readings and stamps before they enter a track.

    Args:
        actuators: actuators read by the model.
        dropped: number of dropped messages by reason, updated in place.

    Attributes:
        now: current time [s]; infinite before it is known.
    """

    def __init__(
        self, track: VehicleTrack, actuators: Collection[str], timeouts: Timeouts, dropped: Counter[str]
    ) -> None:
        self._track, self._timeouts, self.dropped = track, timeouts, dropped
        self._needed, self.now = tuple(actuators), np.inf

    def vehicle(self, reading: VehicleReading) -> Literal["dropped", "taken", "jumped"]:
        """Add a reading, and return whether it was dropped, or jumped, which invalidates the map."""
        if self.ahead("readings of the vehicle", reading.time):
            return "dropped"
        latest, measured = self._track.latest, reading.measured(self._needed)
        lacks = [name for name, value in zip(self._needed, measured, strict=True) if not np.isfinite(value)]
        fault = ""
        if not reading.finite:
            fault = "that are not finite"
        elif lacks:
            fault = f"without {', '.join(lacks)}, which the model reads"
        elif latest is not None and reading.time <= latest.time:
            fault = "whose stamps repeat or go back"
        if fault:
            self.dropped[f"readings of the vehicle {fault}"] += 1
            return "dropped"
        return "jumped" if self._track.add(reading) else "taken"

    def ahead(self, what: str, time: float) -> bool:
        """Return whether a stamp is ahead of the clock, and count it; it would make later messages appear old."""
        ahead = time > self.now + self._timeouts.ahead
        if ahead:
            self.dropped[f"{what}: stamps ahead of the clock"] += 1
        return ahead
