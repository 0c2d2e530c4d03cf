"""Rig: vehicle, channels, sensors and clocks of a log, read from a TOML file."""

import tomllib
from importlib import resources
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import Meta
from msgspec.structs import replace

from offpiste.core.channels import Actuator, Control, actuator_columns, all_actuators, control_columns
from offpiste.core.errors import RigError, did_you_mean
from offpiste.core.limits import packaged_table, parsed, read_small
from offpiste.core.registry import load_extensions
from offpiste.rig.channels import Alignment, ChannelSource, Clock, check_channels
from offpiste.rig.outputs import Live, Output, check_outputs
from offpiste.rig.schema import Positive, converted, refuse
from offpiste.rig.sensors import CameraSource, Frames, LidarSource, check_sensors

GUESSED: Final = "GUESSED"
"""Prefix of `Vehicle.source` in a drafted rig."""
VARIANTS: Final = packaged_table("offpiste.rig", "variants.toml")
"""Presets that are the text of another one with a few changes."""

_Metres = Annotated[float, Meta(gt=-100.0, lt=100.0)]
Wheel = tuple[_Metres, _Metres]
"""Position of a wheel: x forward, y left of the pose point [m]."""


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Mass and geometry of a vehicle."""

    mass: Positive
    wheel_positions: tuple[Wheel, Wheel, Wheel, Wheel]  # front-left, front-right, rear-left, rear-right
    pose_point: str  # description of the point whose pose is logged
    max_steer: float = 0.0  # road-wheel angle at a steering command of 1 [rad]; 0 for a vehicle that does not steer
    source: str = ""

    @property
    def is_guessed(self) -> bool:
        """Whether mass and geometry are those of a drafted rig."""
        return self.source.startswith(GUESSED)

    @property
    def rear_axle(self) -> float:
        """Distance of the rear axle behind the pose point [m]."""
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


def check_vehicle(vehicle: Vehicle, *, steers: bool) -> None:
    """Refuse wheels in another order; vehicles that steer need a `max_steer`."""
    left, right, rear_left, rear_right = (y for _, y in vehicle.wheel_positions)
    order = "left is +y: give front-left, front-right, rear-left, rear-right"
    straight = (steers or vehicle.max_steer != 0) and not 0 < vehicle.max_steer < np.pi / 2
    refuse(
        (vehicle.wheelbase <= 0, "the front wheels are not ahead of the rear wheels", "fix vehicle.wheel_positions"),
        (left < right or rear_left < rear_right, "vehicle.wheel_positions have left and right exchanged", order),
        (straight, f"vehicle.max_steer is {vehicle.max_steer} rad", "give a road-wheel angle below pi/2"),
    )


class Motion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Estimation of planar motion from poses."""

    window: Positive = 0.3  # span of the pose samples behind one estimate [s]
    slope_length: Positive = 6.0  # length of path over which elevation is fitted for the slope of the driven path [m]
    normals: Literal["driven path", "flat"] = "driven path"  # in place of a map
    # Axes of the log's poses and velocities, rotated to z up on reading: "z up" (body x forward, y left, z up), "body
    # down" (body forward, right, down in a z-up world), "world down" (world north, east, down), or "ned" (both down).
    axes: Literal["z up", "body down", "world down", "ned"] = "z up"


class Rig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Vehicle, and the channels, absent channels, sensors and commands of its logs."""

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
    outputs: dict[str, Output] = {}
    live: Live = Live()

    @property
    def controls(self) -> tuple[Control, ...]:
        """Columns of `control` in datasets of this rig, including absent ones."""
        return control_columns(self.channels)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Columns of `actuators` in datasets of this rig, including absent ones."""
        return actuator_columns([a.name for a in all_actuators() if a.channel in self.channels])

    @property
    def present_controls(self) -> tuple[str, ...]:
        """Names of the controls that this rig's logs have."""
        return tuple(control.name for control in self.controls if control.name in self.channels)

    @property
    def present_actuators(self) -> tuple[str, ...]:
        """Names of the actuators in this rig's logs, including rates that are derived from a position."""
        have = {actuator.name for actuator in self.actuators if actuator.channel in self.channels}
        return tuple(actuator.name for actuator in self.actuators if {actuator.name, actuator.rate_of} & have)

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics of the channels, cameras, calibrations, LiDARs and transforms."""
        cameras = [topic for camera in self.cameras.values() for topic in (camera.topic, camera.info) if topic]
        read = [*(channel.topic for channel in self.channels.values()), *cameras]
        lidars = [lidar.topic for lidar in self.lidars.values()]
        aligned = () if self.alignment is None else self.alignment.topics
        return tuple(dict.fromkeys([*read, *lidars, *self.frames.topics, *aligned]))

    def without_slope(self) -> "Rig":
        """Return the rig with flat ground in place of the driven path's slope (an ablation)."""
        return replace(self, motion=replace(self.motion, normals="flat"))

    def reads_alike(self, *channels: str) -> bool:
        """Return whether all of these channels exist and read the same fields."""
        sources = [self.channels.get(name) for name in channels]
        return all(sources) and len({(source.topic, source.fields) for source in sources if source}) == 1

    def wheel_positions(self) -> Float[np.ndarray, "4 2"]:
        """Return the wheels in the body frame, relative to the pose point [m]."""
        return np.array(self.vehicle.wheel_positions)


def load_rig(name: str | Path) -> Rig:
    """Load a preset by name (see `preset_names`), or a rig from a TOML file.

    Raises:
        RigError: missing preset or file, invalid TOML, an unknown or missing key, a wrong type, contradicting entries.
    """
    rig = parse_rig(rig_text(name), where=str(name))
    if _is_preset(name):
        return rig
    folder = Path(name).resolve().parent  # of paths in the file
    cameras = {n: replace(c, mask=str(folder / c.mask)) if c.mask else c for n, c in rig.cameras.items()}
    live = replace(rig.live, definitions=tuple(str(folder / path) for path in rig.live.definitions))
    return replace(rig, cameras=cameras, live=live)


def rig_text(name: str | Path) -> str:
    """Return the TOML text of a preset or of a rig file."""
    if _is_preset(name):
        variant = VARIANTS.get(str(name), {"of": name, "changes": ()})
        text = (resources.files("offpiste.rig") / "presets" / f"{variant['of']}.toml").read_text("utf-8")
        for old, new in variant["changes"]:
            text = text.replace(old, new)
        return text
    try:
        return read_small(Path(name))
    except (OSError, UnicodeDecodeError) as error:
        how = f"{did_you_mean(str(name), preset_names())}give a .toml file or one of: {', '.join(preset_names())}"
        how += "; `offpiste inspect LOG --write-rig my.toml` writes a first one"
        raise RigError("no such rig", where=name, how=how) from error


def _is_preset(name: str | Path) -> bool:
    return Path(name).suffix != ".toml" and str(name) in preset_names()


def parse_rig(text: str, *, where: str) -> Rig:
    """Parse a rig from TOML text; errors name it by `where`."""
    load_extensions()  # may declare channels
    try:
        rig = converted(parsed(text, tomllib.loads), Rig)
        check_rig(rig)
    except ValueError as error:
        raise RigError(f"not valid TOML: {error}", where=where, how="fix the line that is named") from error
    except RigError as error:
        raise RigError(error.what, where=where, how=error.how) from None
    return rig


def preset_names() -> list[str]:
    """Return the names of the rigs that ship with the package."""
    folder = resources.files("offpiste.rig") / "presets"
    files = (file.name.removesuffix(".toml") for file in folder.iterdir() if file.name.endswith(".toml"))
    return sorted((*files, *VARIANTS))


def check_rig(rig: Rig) -> None:
    """Refuse contradicting entries that types do not exclude."""
    check_channels(rig.channels, rig.absent, rig.vehicle.max_steer)
    check_vehicle(rig.vehicle, steers="steer" in rig.channels)
    check_sensors(rig.cameras, rig.lidars)
    epoch = next((name for name, lidar in rig.lidars.items() if lidar.time_field and lidar.time_origin == "epoch"), "")
    how = 'point times use the LiDAR\'s clock: use clock.stamps = "header", or leave out time_field'
    what = f'lidars.{epoch}.time_origin is "epoch" and clock.stamps is "receive"'
    refuse((epoch and rig.clock.stamps == "receive", what, how))
    check_outputs(rig.outputs, rig.live, rig.vehicle.max_steer)
