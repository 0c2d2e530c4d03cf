"""What the vehicle has said of itself in the last seconds, for planning and mapping: rows at 50 Hz, and poses."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from offpiste.conventions import DT, HISTORY_STEPS
from offpiste.dataset.columns import COLUMNS
from offpiste.dataset.resample import OWN_COLUMNS
from offpiste.geometry import planar_body_from_world
from offpiste.logs.channel import Channel
from offpiste.logs.poses import Poses

JUMP = 1.0
"""A pose further from where the vehicle's speed would have brought it than this is a jump [m]."""


@dataclass(frozen=True)
class VehicleReading:
    """The vehicle at one moment.

    Attributes:
        time: stamp [s].
        position: of the pose point in the world frame [m].
        orientation: world_from_body, xyzw.
        velocity: of the pose point in the world frame [m/s].
        yaw_rate: d(yaw)/dt [rad/s].
        actuators: of `conventions.ACTUATORS`; NaN where the vehicle does not tell.
        extra: values of columns that extensions declare (`dataset.columns.COLUMNS`), by name.
    """

    time: float
    position: Float[np.ndarray, " 3"]
    orientation: Float[np.ndarray, " 4"]
    velocity: Float[np.ndarray, " 3"]
    yaw_rate: float
    actuators: Float[np.ndarray, " A"]
    extra: Mapping[str, float] = field(default_factory=dict)

    @property
    def finite(self) -> bool:
        """Whether nothing that is needed is missing."""
        known = np.concatenate(([self.time, self.yaw_rate], self.position, self.orientation, self.velocity))
        return bool(np.isfinite(known).all() and np.abs(self.orientation).max() > 0)


@dataclass(frozen=True)
class TrackRows:
    """Rows t-10 ... t of the vehicle (`conventions.DT` apart), estimated from the past only.

    Attributes:
        state: `conventions.STATE`, in the world frame, yaw unwrapped.
        actuators, control: `conventions.ACTUATORS` and `conventions.CONTROL`; control of row t is not known yet.
        extra: columns that extensions declare for the past of windows; NaN where a reading lacks them.
    """

    state: Float[np.ndarray, "H 6"]
    actuators: Float[np.ndarray, "H A"]
    control: Float[np.ndarray, "H 3"]
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)


class VehicleTrack:
    """Readings and commands of the last seconds.

    Args:
        seconds: that are kept.
        max_gap: poses are not interpolated between readings further apart [s].
    """

    def __init__(self, *, seconds: float = 3.0, max_gap: float = 0.25) -> None:
        self._seconds, self._max_gap = seconds, max_gap
        self._readings: deque[VehicleReading] = deque()
        self._commands: deque[tuple[float, np.ndarray]] = deque()

    @property
    def latest(self) -> VehicleReading | None:
        """The last reading."""
        return self._readings[-1] if self._readings else None

    @property
    def enough(self) -> bool:
        """Whether there are poses to interpolate between."""
        return len(self._readings) >= 2

    def add(self, reading: VehicleReading) -> bool:
        """Take a reading in; says whether the pose jumped, so that what was mapped before fits nothing after."""
        before = self.latest
        jumped = False
        if before is not None:
            expected = before.position + before.velocity * (reading.time - before.time)
            jumped = bool(np.linalg.norm(reading.position - expected) > JUMP)
        if jumped:
            self._readings.clear()
        self._readings.append(reading)
        while self._readings[0].time < reading.time - self._seconds:
            self._readings.popleft()
        return jumped

    def clear(self) -> None:
        """Forget all."""
        self._readings.clear()
        self._commands.clear()

    def commanded(self, time: float, control: Float[np.ndarray, " 3"]) -> None:
        """Note what is commanded from now on."""
        self._commands.append((time, control))
        while self._commands[0][0] < time - self._seconds:
            self._commands.popleft()

    def poses(self) -> Poses:
        """Poses of the last seconds."""
        time = np.array([r.time for r in self._readings])
        position = Channel("position", "m", time, np.stack([r.position for r in self._readings]))
        orientation = Channel("orientation", "1", time, np.stack([r.orientation for r in self._readings]))
        return Poses(position, orientation, self._max_gap)

    def rows(self, now: float) -> TrackRows:
        """The last 0.2 s and now; the first reading stands for the time before it."""
        time = np.array([r.time for r in self._readings])
        at = now - DT * np.arange(HISTORY_STEPS, -1, -1)
        index = np.clip(np.searchsorted(time, at + 1e-6, side="right") - 1, 0, len(time) - 1)
        chosen = [self._readings[int(i)] for i in index]
        age = np.maximum(at - time[index], 0.0)[:, None]
        velocity = np.stack([r.velocity[:2] for r in chosen])
        rate = np.array([[r.yaw_rate] for r in chosen])
        yaw = np.unwrap([_yaw(r.orientation) for r in chosen])[:, None] + age * rate
        place = np.stack([r.position[:2] for r in chosen]) + age * velocity
        state = np.concatenate((place, yaw, planar_body_from_world(velocity, yaw[:, 0]), rate), axis=1)
        extra = {name: np.array([r.extra.get(name, np.nan) for r in chosen]) for name in _past_columns()}
        return TrackRows(state, np.stack([r.actuators for r in chosen]), self._controls(at), extra)

    def _controls(self, at: Float[np.ndarray, " H"]) -> Float[np.ndarray, "H 3"]:
        if not self._commands:
            return np.zeros((len(at), 3))
        time = np.array([t for t, _ in self._commands])
        index = np.searchsorted(time, at + 1e-6, side="right") - 1
        held = np.stack([c for _, c in self._commands])[np.maximum(index, 0)]
        return np.where((index >= 0)[:, None], held, 0.0)


def _past_columns() -> list[str]:
    """Columns of extensions that a model's history holds."""
    return [name for name, column in COLUMNS.items() if name not in OWN_COLUMNS and "past" in column.segments]


def _yaw(quaternion: Float[np.ndarray, " 4"]) -> float:
    """Heading of the body's x axis in the horizontal plane [rad]."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return float(np.arctan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z)))
