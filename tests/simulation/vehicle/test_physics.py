"""Arrays that the compiled physics works on."""

import re
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from offpiste.core.errors import OffpisteError
from offpiste.native.sources import PACKAGE
from offpiste.simulation.vehicle.parameters import RECORD, load_vehicle
from offpiste.simulation.vehicle.physics import STATE, WHEEL
from simulation.drives import drive, flat_world, vehicle_on

TEXT = "".join(file.read_text() for file in sorted((PACKAGE / "native/cpp/simulation").glob("*.h")))


def members(struct):
    """Name and number of doubles of each member of a struct of the physics."""
    body = re.search(rf"struct {struct} \{{(.*?)\}};", re.sub(r"/\*.*?\*/", "", TEXT, flags=re.DOTALL), re.DOTALL)[1]
    for kind, names in re.findall(r"(\w+) ([^;]+);", body):
        doubles = 1 if kind == "double" else sum(count for _, count in members(kind))
        for name, count in re.findall(r"(\w+)(?:\[(\d+)\])?", names):
            yield name, doubles * int(count or 1)


@pytest.mark.parametrize(("struct", "dtype"), [("Parameters", RECORD), ("State", STATE), ("Wheel", WHEEL)])
def test_structs_have_the_layout_of_their_arrays(struct, dtype):
    assert list(members(struct)) == [(name, dtype[name].itemsize // 8) for name in dtype.names]


@pytest.mark.parametrize(
    ("of", "name", "value", "said"),
    [
        ("world", "elevation", np.zeros((1, 121)), "elevation has shape"),
        ("world", "properties", np.zeros((121, 240, 4)), "properties of the ground"),
        ("trees", "trunk_radius", np.zeros(2), "dimensions"),
        ("bushes", "drag", np.zeros(0), "dimensions"),
    ],
)
def test_grids_and_plants_that_would_be_read_beyond_their_ends_are_refused(of, name, value, said):
    world = flat_world(trees=[(0.0, 0.4, 0.15)], bushes=[(0.0, 0.0, 1.0, 600.0)])
    object.__setattr__(world if of == "world" else getattr(world, of), name, value)  # past the checks of its shapes
    with pytest.raises(ValueError, match=said):
        vehicle_on(world)


def test_plants_may_have_any_order_in_memory():
    world = flat_world(trees=[(5.0, 0.2, 0.15), (9.0, 3.0, 0.2)], bushes=[(2.0, 0.0, 1.0, 600.0), (4.0, 1.0, 1.0, 1e3)])
    trees, bushes = (replace(plants, foot=np.asfortranarray(plants.foot)) for plants in (world.trees, world.bushes))
    worlds = world, replace(world, trees=trees, bushes=bushes)
    one, other = (drive(vehicle_on(of, speed=8.0), 1, (1, 0, 0))[-1] for of in worlds)
    np.testing.assert_array_equal(one.position, other.position)


def test_a_vehicle_that_diverges_is_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs there
    vehicle = vehicle_on(speed=5.0)
    vehicle.step(0.5, 0.0, 0.1)
    with pytest.raises(OffpisteError, match=r"diverged after 0\.02 s"):
        vehicle.step(0.5, 0.0, np.nan)
    with pytest.raises(OffpisteError, match="diverged"):
        vehicle_on(parameters=structs.replace(load_vehicle(), stop_stiffness=1e12, bump_travel=1e-3))
