import re
from importlib import resources
from pathlib import Path

import pytest

from offpiste.core.errors import OffpisteError
from offpiste.rig.rig import load_rig, parse_rig
from offpiste.simulation.vehicle.parameters import load_vehicle, vehicle_rig

TEXT = (resources.files("offpiste.simulation.vehicle") / "side_by_side.toml").read_text()


def test_sprung_and_unsprung_masses_have_the_vehicles_centre():
    p = load_vehicle()
    x, y, z = p.sprung_com
    assert p.sprung_mass * x / p.mass == pytest.approx(p.wheelbase * (p.front_share - 0.5))
    assert y == 0
    assert p.sprung_mass * z / p.mass + p.rest_height == pytest.approx(p.com_height)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mass = 1150.0", "mass = -1.0", "mass"),
        ("track = 1.32", "trakc = 1.32", "did you mean 'track'"),
        ("track = 1.32", "", "track"),
        ("track = 1.32", "track = ", "not TOML"),
        ("mass = 1150.0", "mass = 60.0", r"the mass \(60 kg\) is less than that of the four wheels"),
        (
            "yaw_inertia = 950.0",
            "yaw_inertia = 1950.0",
            r"yaw_inertia \(1950\) exceeds the sum of the other two",
        ),
    ],
)
def test_errors_name_the_key(tmp_path, old, new, said):
    file = tmp_path / "vehicle.toml"
    file.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(OffpisteError, match=said):
        load_vehicle(file)


@pytest.mark.parametrize("preset", ["proving_ground", "proving_ground_gear"])
def test_the_vehicles_numbers_are_in_its_rig(tmp_path: Path, preset: str) -> None:
    file, text = tmp_path / "truck.toml", TEXT
    for key, value in {"mass": 2400.0, "wheelbase": 3.0, "track": 1.6, "max_steer": 0.6, "rolling_radius": 0.4}.items():
        text = re.sub(rf"^{key} = .*", f"{key} = {value}", text, flags=re.MULTILINE)
    file.write_text(text)
    rig, before = parse_rig(vehicle_rig(preset, file), where="truck"), load_rig(preset)
    vehicle = rig.vehicle
    assert (vehicle.mass, vehicle.max_steer, rig.name) == (2400.0, 0.6, "truck")
    assert (vehicle.wheelbase, vehicle.track, vehicle.rear_axle) == pytest.approx((3.0, 1.6, 1.5))
    assert rig.channels["wheel_speed"].scale == pytest.approx(0.4)
    for part in ("cameras", "lidars", "clock", "motion", "absent"):
        assert getattr(rig, part) == getattr(before, part)
    assert {**rig.channels, "wheel_speed": None} == {**before.channels, "wheel_speed": None}
