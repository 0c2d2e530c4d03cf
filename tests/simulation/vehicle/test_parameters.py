from importlib import resources

import pytest

from offpiste.core.conventions import GRAVITY
from offpiste.simulation.vehicle.parameters import VehicleError, load_vehicle

TEXT = (resources.files("offpiste.simulation.vehicle") / "side_by_side.toml").read_text()


def test_shipped_vehicle_is_a_side_by_side():
    p = load_vehicle()
    assert 900 <= p.mass <= 1500
    assert p.static_load_front * 2 + p.static_load_rear * 2 == pytest.approx(p.mass * GRAVITY)
    # Static stability factor; laden side-by-sides have about 0.9 to 1.05.
    assert 0.9 < p.track / 2 / p.com_height < 1.05


def test_sprung_and_unsprung_masses_have_the_vehicles_centre():
    p = load_vehicle()
    x, y, z = p.sprung_com
    assert p.sprung_mass * x / p.mass == pytest.approx(p.wheelbase * (p.front_share - 0.5))
    assert y == 0
    assert p.sprung_mass * z / p.mass + p.rest_height == pytest.approx(p.com_height)


def test_every_value_says_where_it_comes_from():
    for line in TEXT.splitlines():
        if "=" in line.split("#")[0]:
            assert len(line.partition("#")[2]) > 6, line


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mass = 1150.0", "mass = -1.0", "mass"),
        ("track = 1.32", 'track = "wide"', "track"),
        ("track = 1.32", "trakc = 1.32", "trakc"),
        ("track = 1.32", "", "track"),
        ("track = 1.32", "track = ", "not TOML"),
        ("mass = 1150.0", "mass = 60.0", "mass is 60 kg, and its four wheels are"),
        ("yaw_inertia = 950.0", "yaw_inertia = 1950.0", "yaw_inertia is 1950, more than the other two together"),
    ],
)
def test_errors_name_the_key(tmp_path, old, new, said):
    file = tmp_path / "vehicle.toml"
    file.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(VehicleError, match=said):
        load_vehicle(file)


def test_missing_file(tmp_path):
    with pytest.raises(VehicleError, match=r"cannot read the vehicle.*No such file"):
        load_vehicle(tmp_path / "none.toml")
