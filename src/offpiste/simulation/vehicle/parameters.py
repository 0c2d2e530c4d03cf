"""Parameters of the simulated vehicle, read from TOML and validated, and the rig of a vehicle."""

import re
from importlib import resources
from pathlib import Path
from typing import Annotated, Final

import msgspec
import numpy as np

from offpiste.core.conventions import GRAVITY
from offpiste.core.errors import OffpisteError
from offpiste.rig.edits import Edit, edited_text
from offpiste.rig.rig import rig_text
from offpiste.simulation.world.world import read_toml

Positive = Annotated[float, msgspec.Meta(gt=0)]
Share = Annotated[float, msgspec.Meta(gt=0, lt=1)]


class VehicleParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parameters of a side-by-side; side_by_side.toml documents meaning, unit and source of each.

    The pose point is the centre of the wheel base at the height of the wheel centres at rest, with wheels at
    x = +-wheelbase / 2, y = +-track / 2.
    """

    wheelbase: Positive
    track: Positive
    mass: Positive
    front_share: Share
    com_height: Positive
    roll_inertia: Positive
    pitch_inertia: Positive
    yaw_inertia: Positive
    length: Positive
    width: Positive
    belly_height: float
    bumper_height: float
    roof_height: Positive
    drag_area: Positive
    air_density: Positive

    unsprung_mass: Positive
    spring_front: Positive
    spring_rear: Positive
    damper_front: Positive
    damper_rear: Positive
    damper_asymmetry: Share
    anti_roll_front: Positive
    anti_roll_rear: Positive
    bump_travel: Positive
    droop_travel: Positive
    stop_stiffness: Positive
    stop_damping: Positive

    wheel_radius: Positive
    rolling_radius: Positive
    tyre_width: Positive
    tyre_stiffness: Positive
    tyre_damping: Positive
    rim_deflection: Positive
    rim_stiffness: Positive
    wheel_inertia: Positive
    slip_stiffness_ratio: Positive
    relaxation_length: Positive
    standstill_damping: Positive
    standstill_speed: Positive
    envelope_length: Positive
    resistance_speed: Positive

    engine_torque: Positive
    engine_torque_speed: Positive
    engine_torque_bend: Positive
    engine_drag: Positive
    engine_drag_slope: Positive
    engine_inertia: Positive
    idle_speed: Positive
    idle_gain: Positive
    limiter_speed: Positive
    limiter_band: Positive

    ratio_low: Positive
    ratio_high: Positive
    final_ratio: Positive
    shift_time: Positive
    gear_time: Positive
    cruise_speed: Positive
    power_speed: Positive
    clutch_speed: Positive
    clutch_gain: Positive
    clutch_rate: Positive
    centre_rate: Positive
    front_rate: Positive
    rear_rate: Positive
    shaft_drag: Positive
    shaft_drag_slope: Positive

    brake_torque: Positive
    brake_front_share: Share
    brake_delay: Positive
    brake_time: Positive
    max_steer: Annotated[float, msgspec.Meta(gt=0, lt=1.2)]
    max_steer_rate: Positive
    steer_frequency: Positive
    steer_damping: Positive

    @property
    def wheel_places(self) -> tuple[tuple[float, float], ...]:
        """Positions x, y of the wheels in the body frame, in the usual order [m]."""
        x, y = self.wheelbase / 2, self.track / 2
        return (x, y), (x, -y), (-x, y), (-x, -y)

    @property
    def spring_loads(self) -> tuple[float, float]:
        """Loads of one front and one rear spring on flat ground at rest [N]."""
        front, rear = (self.mass * share / 2 for share in (self.front_share, 1 - self.front_share))
        return (front - self.unsprung_mass) * GRAVITY, (rear - self.unsprung_mass) * GRAVITY

    @property
    def rest_height(self) -> float:
        """Height of the pose point above flat ground at rest: mean loaded radius [m]."""
        return self.wheel_radius - self.mass * GRAVITY / 4 / self.tyre_stiffness

    @property
    def sprung_mass(self) -> float:
        """Mass of the chassis without the wheels [kg]."""
        return self.mass - 4 * self.unsprung_mass

    @property
    def sprung_com(self) -> tuple[float, float, float]:
        """Centre of the sprung mass in the body frame, from the pose point [m]."""
        scale = self.mass / self.sprung_mass
        return scale * self.wheelbase * (self.front_share - 0.5), 0.0, scale * (self.com_height - self.rest_height)

    def as_record(self) -> np.ndarray:
        """Return the parameters and what follows from them, for compiled code (`RECORD`)."""
        values = (*msgspec.structs.astuple(self), *self.spring_loads, self.sprung_com)
        return np.array(values, RECORD)


RECORD: Final = np.dtype(
    [
        *((name, float) for name in VehicleParameters.__struct_fields__),
        ("spring_load_front", float),
        ("spring_load_rear", float),
        ("sprung_com", float, 3),
    ]
)
"""Parameters as compiled code reads them; `Parameters` in native/cpp/simulation/parameters.h."""


def load_vehicle(path: str | Path | None = None) -> VehicleParameters:
    """Read a vehicle's TOML file; None for the shipped side-by-side.

    Raises:
        OffpisteError: the file is missing or not TOML, or a key is unknown, missing or out of range.
    """
    file = resources.files(__package__) / "side_by_side.toml" if path is None else Path(path)
    vehicle = read_toml(file, VehicleParameters, "vehicle", "vehicle/side_by_side.toml")
    if vehicle.sprung_mass <= 0:
        what = f"the mass ({vehicle.mass:g} kg) is less than that of the four wheels ({4 * vehicle.unsprung_mass:g} kg)"
        raise OffpisteError(what, where=str(file), how="give mass of the whole vehicle, and unsprung_mass of one wheel")
    moments = {key: getattr(vehicle, key) for key in ("roll_inertia", "pitch_inertia", "yaw_inertia")}
    largest = max(moments, key=lambda key: moments[key])
    if 2 * moments[largest] > sum(moments.values()):
        what = f"{largest} ({moments[largest]:g}) exceeds the sum of the other two moments, which is impossible"
        raise OffpisteError(what, where=str(file), how="give moments of inertia about the centre of mass [kg m^2]")
    return vehicle


_HEADER: Final = """\
# Rig `{preset}` with the mass, axles, wheels and steering of {vehicle}.
# own_body of cameras and LiDARs is that of the side-by-side: adapt it to another body.
"""


def vehicle_rig(preset: str, vehicle: Path) -> str:
    """Return the TOML text of a rig that reads drives of `simulate --vehicle`, from a rig of the proving ground."""
    parameters = load_vehicle(vehicle)
    entries = {
        "name": re.sub(r"[^\w -]", "_", vehicle.stem),
        "description": "Another vehicle on the proving ground",
        "vehicle.mass": parameters.mass,
        "vehicle.max_steer": parameters.max_steer,
        "vehicle.wheel_positions": [list(place) for place in parameters.wheel_places],
        "vehicle.source": "its file of `simulate --vehicle`",
        "channels.wheel_speed.scale": parameters.rolling_radius,
    }
    text = edited_text(rig_text(preset), [Edit(key, value) for key, value in entries.items()])
    return _HEADER.format(preset=preset, vehicle=vehicle.name) + text.partition("\n")[2]
