"""A vehicle and its log: geometry, and which topic or column feeds which channel, in what unit, sign and frame."""

import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.conventions import ACTUATORS, CONTROL
from offpiste.errors import RigError
from offpiste.registry import load_extensions
from offpiste.rig.sensors import CameraSource, Frames, LidarSource, beside, check_sensors

_UNITS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048},
    "rad": {"rad": 1.0, "deg": np.pi / 180, "mrad": 0.001},
    "m/s": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 0.514444},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180, "rev/min": 2 * np.pi / 60},
    "1000 rev/min": {"1000 rev/min": 1.0, "rev/min": 0.001, "rad/s": 60 / (2 * np.pi) / 1000},
    "1": {"1": 1.0, "percent": 0.01, "permille": 0.001},
}
"""Factors from the units a log may use to the one offpiste uses (the key)."""

CHANNELS: dict[str, tuple[str, tuple[int, ...]]] = {
    "position": ("m", (2, 3)),
    "orientation": ("1", (4,)),
    "yaw": ("rad", (1,)),
    "linear_velocity": ("m/s", (2, 3)),
    "angular_velocity": ("rad/s", (3,)),
    "yaw_rate": ("rad/s", (1,)),
    "throttle": ("1", (1,)),
    "brake": ("1", (1,)),
    "steer": ("1", (1,)),
    "brake_pressure": ("1", (1,)),
    "steer_angle": ("rad", (1,)),
    "steer_rate": ("rad/s", (1,)),
    "engine_rpm": ("1000 rev/min", (1,)),
    "wheel_speed": ("m/s", (1, 2, 4)),
}
"""Channel name -> (unit inside offpiste, allowed numbers of fields)."""


def declare_channel(
    name: str, *, unit: str, fields: tuple[int, ...] = (1,), units: Mapping[str, float] | None = None
) -> None:
    """Let rigs name one more channel.

    Args:
        unit: inside offpiste.
        fields: allowed numbers of fields.
        units: factors from the units a log may use to `unit`, where that is a new one.

    Raises:
        RigError: there is a channel of this name.
    """
    if name in CHANNELS:
        raise RigError(f"there are two channels called '{name}'", how="give one of them another name")
    CHANNELS[name] = unit, fields
    _UNITS.setdefault(unit, {unit: 1.0}).update(units or {})


CONTROL_CHANNELS = CONTROL
ACTUATOR_CHANNELS = ("brake_pressure", "steer_angle", "steer_rate", "engine_rpm")
"""Channels behind the columns of `control` and `actuators`, in their order."""

assert len(ACTUATOR_CHANNELS) == len(ACTUATORS)


class Wrap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A counter that wraps around: raw values above `above` are `period` too large."""

    above: float
    period: float


class ChannelSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a channel comes from: value = sign * ((raw, unwrapped) * scale + offset), then from `unit`.

    Attributes:
        topic: topic, folder or, in a table, "" for the table itself.
        fields: fields or columns in the channel's order: x y z, or a quaternion as x y z w.
        frame: for velocities: "world", "body", or "unknown" (then the pose is differentiated instead).
        delay: how much later than it happened a sample is stamped [s].
        valid: values outside of it (after conversion) are measurement faults and dropped.
        clip: values are limited to this interval.
        interpolation: between samples: a command holds, a measurement is interpolated.
    """

    fields: tuple[str, ...]
    topic: str = ""
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    sign: Literal[-1, 1] = 1
    delay: float = 0.0
    frame: Literal["", "world", "body", "unknown"] = ""
    wrap: Wrap | None = None
    valid: tuple[float, float] | None = None
    clip: tuple[float, float] | None = None
    interpolation: Literal["linear", "hold"] = "linear"


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Geometry and mass.

    Attributes:
        wheel_positions: x forward, y left of the pose point [m]: front-left, front-right, rear-left, rear-right.
        pose_point: which point of the vehicle the pose is of, in words.
        max_steer: road-wheel angle at a steering command of 1 [rad].
    """

    mass: float
    wheel_positions: tuple[tuple[float, float], tuple[float, float], tuple[float, float], tuple[float, float]]
    pose_point: str
    max_steer: float
    source: str = ""

    @property
    def rear_axle(self) -> float:
        """How far behind the pose point the rear axle lies [m]."""
        return -(self.wheel_positions[2][0] + self.wheel_positions[3][0]) / 2

    @property
    def wheelbase(self) -> float:
        """Distance between the axles [m]."""
        front_left, front_right, rear_left, rear_right = (x for x, _ in self.wheel_positions)
        return (front_left + front_right - rear_left - rear_right) / 2


class Clock(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How rows are stamped: a message's header or its arrival (bags), a column (tables), and what counts as a gap.

    Attributes:
        column: a table's time column.
        unit: of that column: s, ms, us or ns.
        max_gap: samples further apart are not interpolated between; a drive is cut there [s].
    """

    stamps: Literal["header", "receive"] = "header"
    column: str = ""
    unit: Literal["s", "ms", "us", "ns"] = "s"
    max_gap: float = 0.5


class Alignment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Topics whose common clock drifts against the pose's; the wheels' speed tells by how much.

    Attributes:
        topics: all topics stamped by that clock.
        speed: the vehicle's speed by the wheels, among them; several fields are averaged [m/s after conversion].
        max_lag: lags from minus half of it to all of it are tried [s].
    """

    topics: tuple[str, ...]
    speed: ChannelSource
    max_lag: float = 2.0


class Motion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How planar motion is estimated where the log has no velocities of its own.

    Attributes:
        window: span of pose samples behind one estimate [s].
        slope_length: metres of path over which elevation is fitted for the driven path's slope.
        normals: "driven path" (the stand-in without LiDAR) or "flat".
    """

    window: float = 0.3
    slope_length: float = 6.0
    normals: Literal["driven path", "flat"] = "driven path"


class Rig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A vehicle, its log's channels, the channels that its log does not have, and its sensors by name."""

    name: str
    vehicle: Vehicle
    channels: dict[str, ChannelSource]
    description: str = ""
    absent: tuple[str, ...] = ()
    clock: Clock = Clock()
    motion: Motion = Motion()
    alignment: Alignment | None = None
    frames: Frames = Frames()
    cameras: dict[str, CameraSource] = {}
    lidars: dict[str, LidarSource] = {}

    def without_slope(self) -> "Rig":
        """The same rig with flat ground in place of the driven path's slope (an ablation)."""
        return msgspec.structs.replace(self, motion=msgspec.structs.replace(self.motion, normals="flat"))

    def wheel_positions(self) -> Float[np.ndarray, "4 2"]:
        """Wheels in the body frame, from the pose point [m]."""
        return np.array(self.vehicle.wheel_positions)


def unit_factor(channel: str, unit: str) -> float:
    """Factor from a log's unit to offpiste's unit of this channel; an empty unit means offpiste's own.

    Raises:
        RigError: the unit does not measure this channel.
    """
    own = CHANNELS[channel][0]
    known = _UNITS[own]
    if unit and unit not in known:
        raise RigError(f"unit '{unit}' does not measure {channel}", how=f"use one of: {', '.join(known)}")
    return known[unit or own]


def load_rig(name: str | Path) -> Rig:
    """A rig from a preset's name (see `preset_names`) or from a TOML file.

    Raises:
        RigError: no such preset or file, not TOML, an unknown or missing key, a wrong type, contradicting channels.
    """
    path = Path(name)
    if path.suffix != ".toml" and str(name) in preset_names():
        text = (resources.files("offpiste.rig") / "presets" / f"{name}.toml").read_text("utf-8")
        return parse_rig(text, where=str(name))
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(
            "no such rig",
            where=path,
            how=f"give a .toml file or one of: {', '.join(preset_names())}; `offpiste inspect LOG --write-rig`"
            " writes a first one",
        ) from error
    rig = parse_rig(text, where=str(path))
    return msgspec.structs.replace(rig, cameras=beside(rig.cameras, path.resolve().parent))


def parse_rig(text: str, *, where: str) -> Rig:
    """A rig from TOML text; `where` names it in errors (see `load_rig`)."""
    load_extensions()  # may declare channels
    try:
        rig = msgspec.convert(tomllib.loads(text), type=Rig)
    except tomllib.TOMLDecodeError as error:
        raise RigError(f"not valid TOML: {error}", where=where, how="mend the line that is named") from error
    except msgspec.ValidationError as error:
        raise RigError(str(error), where=where, how="see docs/rig.md for the keys of a rig") from error
    try:
        _check(rig)
    except RigError as error:
        raise RigError(error.what, where=where, how=error.how) from None
    return rig


def preset_names() -> list[str]:
    """Names of the rigs that ship with the package."""
    folder = resources.files("offpiste.rig") / "presets"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))


def _check(rig: Rig) -> None:
    for name, source in rig.channels.items():
        if name not in CHANNELS:
            raise RigError(f"unknown channel '{name}'", how=f"channels are: {', '.join(CHANNELS)}")
        widths = CHANNELS[name][1]
        if len(source.fields) not in widths:
            raise RigError(
                f"channels.{name}.fields has {len(source.fields)} entries",
                how=f"it takes {' or '.join(map(str, widths))}",
            )
        unit_factor(name, source.unit)
        if name in ("linear_velocity", "angular_velocity") and not source.frame:
            raise RigError(
                f"channels.{name}.frame is missing",
                how='say "world", "body" or "unknown"; `offpiste inspect` tells which fits',
            )
        if name in rig.absent:
            raise RigError(f"channel '{name}' is both given and declared absent", how="remove one of the two")
    unknown = set(rig.absent) - set(CHANNELS)
    if unknown:
        raise RigError(f"absent: unknown channel '{min(unknown)}'", how=f"channels are: {', '.join(CHANNELS)}")
    if "position" not in rig.channels:
        raise RigError("channels.position is missing", how="every rig needs the vehicle's position")
    if not {"orientation", "yaw"} & set(rig.channels):
        raise RigError("channels.orientation or channels.yaw is missing", how="every rig needs the vehicle's heading")
    for name in (*CONTROL_CHANNELS, *ACTUATOR_CHANNELS):
        derived = name == "steer_rate" and "steer_angle" in rig.channels
        if name not in rig.channels and name not in rig.absent and not derived:
            raise RigError(
                f"channel '{name}' is neither given nor declared absent",
                how=f"add [channels.{name}], or '{name}' to absent",
            )
    for key, number in (
        ("clock.max_gap", rig.clock.max_gap),
        ("motion.window", rig.motion.window),
        ("motion.slope_length", rig.motion.slope_length),
        ("alignment.max_lag", rig.alignment.max_lag if rig.alignment else 1.0),
    ):
        if not 0 < number < np.inf:
            raise RigError(f"{key} is {number}", how="give a number above zero")
    if not 0 < rig.vehicle.mass < np.inf:
        raise RigError(f"vehicle.mass is {rig.vehicle.mass} kg", how="give the mass in kg")
    if not 0 < rig.vehicle.wheelbase < np.inf:
        raise RigError("the front wheels are not ahead of the rear wheels", how="mend vehicle.wheel_positions")
    if not 0 < rig.vehicle.max_steer < np.pi / 2:
        raise RigError(f"vehicle.max_steer is {rig.vehicle.max_steer} rad", how="give a road-wheel angle below pi/2")
    check_sensors(rig.cameras, rig.lidars)
