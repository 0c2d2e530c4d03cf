"""A vehicle and its log: geometry, and which topic or column feeds which channel, in what unit, sign and frame."""

import tomllib
from collections.abc import Collection, Mapping
from importlib import resources
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.channels import (
    Actuator,
    Control,
    actuator_columns,
    all_actuators,
    all_controls,
    control_columns,
)
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

_OTHERS: dict[str, tuple[str, tuple[int, ...]]] = {
    "position": ("m", (2, 3)),
    "orientation": ("1", (4,)),
    "yaw": ("rad", (1,)),
    "linear_velocity": ("m/s", (2, 3)),
    "angular_velocity": ("rad/s", (3,)),
    "yaw_rate": ("rad/s", (1,)),
    "wheel_speed": ("m/s", (1, 2, 4)),
}
"""Channels besides controls and actuators: name -> (unit inside offpiste, allowed numbers of fields)."""


def declare_channel(
    name: str, *, unit: str, fields: tuple[int, ...] = (1,), units: Mapping[str, float] | None = None
) -> None:
    """Let rigs name one more channel; controls and actuators are declared in `offpiste.channels`.

    Args:
        unit: inside offpiste.
        fields: allowed numbers of fields.
        units: factors from the units a log may use to `unit`, where that is a new one.

    Raises:
        RigError: there is a channel of this name.
    """
    if name in known_channels():
        raise RigError(f"there are two channels called '{name}'", how="give one of them another name")
    _OTHERS[name] = unit, fields
    _UNITS.setdefault(unit, {unit: 1.0}).update(units or {})


def known_channels() -> dict[str, tuple[str, tuple[int, ...]]]:
    """Every channel that a rig can give: name -> (unit inside offpiste, allowed numbers of fields)."""
    single = (1,)
    controls = {control.name: (control.unit, single) for control in all_controls()}
    actuators = {actuator.channel: (actuator.unit, single) for actuator in all_actuators()}
    return _OTHERS | controls | actuators


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
        max_steer: road-wheel angle at a steering command of 1 [rad]; 0 for a vehicle that does not steer.
    """

    mass: float
    wheel_positions: tuple[tuple[float, float], tuple[float, float], tuple[float, float], tuple[float, float]]
    pose_point: str
    max_steer: float = 0.0
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

    @property
    def track(self) -> float:
        """Distance between the left and the right wheels, or tracks [m]."""
        front_left, front_right, rear_left, rear_right = (y for _, y in self.wheel_positions)
        return (front_left - front_right + rear_left - rear_right) / 2


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

    @property
    def controls(self) -> tuple[Control, ...]:
        """The columns of `control` in datasets of this rig, those that its logs lack included."""
        return control_columns(self.channels)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """The columns of `actuators` in datasets of this rig, those that its logs lack included."""
        return actuator_columns([a.name for a in all_actuators() if a.channel in self.channels])

    @property
    def present_controls(self) -> tuple[str, ...]:
        """Names of the controls that this rig's logs have."""
        return tuple(control.name for control in self.controls if control.name in self.channels)

    @property
    def present_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that this rig's logs have; a rate can be derived from what it is the rate of."""
        have = {actuator.name for actuator in self.actuators if actuator.channel in self.channels}
        return tuple(actuator.name for actuator in self.actuators if {actuator.name, actuator.rate_of} & have)

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
    own = known_channels()[channel][0]
    known = _UNITS[own]
    if unit and unit not in known:
        raise RigError(f"unit '{unit}' does not measure {channel}", how=f"use one of: {', '.join(known)}")
    return known[unit or own]


def undeclared(given: Collection[str]) -> list[str]:
    """Channels of controls and actuators that a rig must declare absent, or give, besides those that it gives."""
    names = [control.name for control in all_controls() if control.declared]
    names += [
        actuator.channel
        for actuator in all_actuators()
        if actuator.declared and not any(a.name == actuator.rate_of and a.channel in given for a in all_actuators())
    ]
    return [name for name in names if name not in given]


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
        raise RigError(f"not valid TOML: {error}", where=where, how="fix the line that is named") from error
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
    known = known_channels()
    for name, source in rig.channels.items():
        if name not in known:
            raise RigError(f"unknown channel '{name}'", how=f"channels are: {', '.join(known)}")
        widths = known[name][1]
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
    unknown = set(rig.absent) - set(known)
    if unknown:
        raise RigError(f"absent: unknown channel '{min(unknown)}'", how=f"channels are: {', '.join(known)}")
    if "position" not in rig.channels:
        raise RigError("channels.position is missing", how="every rig needs the vehicle's position")
    if not {"orientation", "yaw"} & set(rig.channels):
        raise RigError("channels.orientation or channels.yaw is missing", how="every rig needs the vehicle's heading")
    for name in undeclared(rig.channels):
        if name not in rig.absent:
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
        raise RigError("the front wheels are not ahead of the rear wheels", how="fix vehicle.wheel_positions")
    steers = "steer" in rig.channels or rig.vehicle.max_steer != 0
    if steers and not 0 < rig.vehicle.max_steer < np.pi / 2:
        raise RigError(f"vehicle.max_steer is {rig.vehicle.max_steer} rad", how="give a road-wheel angle below pi/2")
    check_sensors(rig.cameras, rig.lidars)
