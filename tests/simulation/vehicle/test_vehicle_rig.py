"""The rig of another vehicle: its numbers, and everything else as the preset has it."""

from importlib import resources
from pathlib import Path

import msgspec
import pytest

from offpiste.cli.simulate import Simulate
from offpiste.rig.rig import load_rig, parse_rig
from offpiste.simulation.vehicle.vehicle_rig import vehicle_rig


def vehicle_file(folder: Path, **changed: float) -> Path:
    shipped = (resources.files("offpiste.simulation.vehicle") / "side_by_side.toml").read_text("utf-8")
    lines = [
        f"{key} = {changed[key]}" if (key := line.split("=")[0].strip()) in changed else line
        for line in shipped.splitlines()
    ]
    (folder / "truck.toml").write_text("\n".join(lines))
    return folder / "truck.toml"


@pytest.mark.parametrize("preset", ["proving_ground", "proving_ground_gear"])
def test_the_vehicles_numbers_are_in_its_rig(tmp_path: Path, preset: str) -> None:
    file = vehicle_file(tmp_path, mass=2400.0, wheelbase=3.0, track=1.6, max_steer=0.6, rolling_radius=0.4)
    rig, before = parse_rig(vehicle_rig(preset, file), where="truck"), load_rig(preset)
    vehicle = rig.vehicle
    assert (vehicle.mass, vehicle.max_steer, rig.name) == (2400.0, 0.6, "truck")
    assert (vehicle.wheelbase, vehicle.track, vehicle.rear_axle) == pytest.approx((3.0, 1.6, 1.5))
    assert rig.channels["wheel_speed"].scale == pytest.approx(0.4)
    for part in ("cameras", "lidars", "clock", "motion", "absent"):
        assert getattr(rig, part) == getattr(before, part)
    assert {**rig.channels, "wheel_speed": None} == {**before.channels, "wheel_speed": None}


def test_the_side_by_side_has_the_numbers_of_its_preset(tmp_path: Path) -> None:
    rig, before = (
        parse_rig(vehicle_rig("proving_ground", vehicle_file(tmp_path)), where="same"),
        load_rig("proving_ground"),
    )
    same = ("mass", "max_steer", "wheel_positions", "pose_point")
    for key in same:
        assert getattr(rig.vehicle, key) == getattr(before.vehicle, key)
    assert msgspec.to_builtins(rig.channels) == msgspec.to_builtins(before.channels)


def test_simulate_names_the_rig_that_it_writes(tmp_path: Path) -> None:
    file = vehicle_file(tmp_path, mass=2400.0)
    written = Simulate(vehicle=str(file))._rig(tmp_path / "drive.rig.toml")
    assert load_rig(written).vehicle.mass == 2400.0
    assert Simulate()._rig(tmp_path / "unused.toml") == "proving_ground"
    assert not (tmp_path / "unused.toml").exists()
