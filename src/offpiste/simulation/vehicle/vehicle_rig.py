"""The rig of another vehicle on the proving ground: a preset with the vehicle's mass, geometry and wheels."""

import re
from pathlib import Path
from typing import Final

from offpiste.rig.rig import rig_text
from offpiste.simulation.vehicle.parameters import VehicleParameters, load_vehicle

_HEADER: Final = """\
# Rig `{preset}` with the mass, the axles, the wheels and the steering of {vehicle}.
# own_body of cameras and LiDARs is the side-by-side's: fit it to another body.
"""


def vehicle_rig(preset: str, vehicle: Path) -> str:
    """TOML of a rig that reads the drives of `simulate --vehicle`.

    Args:
        preset: rig of the proving ground, for the side-by-side.
        vehicle: its TOML file.

    Raises:
        VehicleError: the file cannot be read.
    """
    text = rig_text(preset)
    for entry, value in _entries(load_vehicle(vehicle), vehicle.stem).items():
        found = re.search(entry, text, re.MULTILINE | re.DOTALL)
        assert found is not None, f"rig {preset} has no {entry}"
        text = f"{text[: found.start(1)]}{value}{text[found.end(1) :]}"
    return _HEADER.format(preset=preset, vehicle=vehicle.name) + text.partition("\n")[2]


def _entries(vehicle: VehicleParameters, name: str) -> dict[str, str]:
    """What differs between vehicles: patterns of the entries, whose groups are their values, and new values."""
    x, y = vehicle.wheelbase / 2, vehicle.track / 2
    plain = re.sub(r"[^\w -]", "_", name)
    return {
        r"^name = ([^\n]*)": f'"{plain}"',
        r"^description = ([^\n]*)": '"Another vehicle on the proving ground"',
        r"^mass = ([^\n]*)": f"{vehicle.mass!r}",
        r"^max_steer = ([^\n]*)": f"{vehicle.max_steer!r}",
        r"^wheel_positions = ([^\n]*)": f"[[{x!r}, {y!r}], [{x!r}, {-y!r}], [{-x!r}, {y!r}], [{-x!r}, {-y!r}]]",
        r"^source = ([^\n]*)": '"its file of `simulate --vehicle`"',
        r"\[channels\.wheel_speed\].*?^scale = ([^\n]*)": f"{vehicle.rolling_radius!r}",
    }
