from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from offpiste.core.errors import OffpisteError
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.grids import read_grid
from offpiste.simulation.world.ground import TREE_CLEARANCE, property_table
from offpiste.simulation.world.terrain import HALF_WIDTH, SPACING
from offpiste.simulation.world.world import WORLDS, WorldSettings, find_world_preset

SMALL = WorldSettings(size=100.0, resolution=0.5)


@pytest.fixture(scope="module", params=list(WORLDS))
def world(request):
    return make_world(WorldSettings(preset=request.param, seed=2, resolution=0.5))


def test_settings_of_grip_and_looks_leave_the_place_as_it_is():
    here, other = (make_world(replace(SMALL, grip_contrast=c, appearance_noise=n)) for c, n in ((1.0, 1.0), (0.5, 0.0)))
    np.testing.assert_array_equal(here.elevation, other.elevation)
    np.testing.assert_array_equal(here.kinds, other.kinds)
    np.testing.assert_array_equal(here.trees.foot, other.trees.foot)
    mean = property_table().mean(axis=(0, 1))
    np.testing.assert_allclose(other.properties - mean, 0.5 * (here.properties - mean), atol=1e-5)


def test_shares_sum_to_one_and_properties_stay_within_the_table(world):
    np.testing.assert_allclose(world.kinds.sum(axis=0), 1, atol=1e-5)
    assert world.kinds.min() >= 0
    assert world.wetness.min() >= 0
    assert world.wetness.max() <= 1
    table = property_table().reshape(-1, 4)
    assert (world.properties >= table.min(axis=0) - 1e-5).all()
    assert (world.properties <= table.max(axis=0) + 1e-5).all()


def test_trails_are_smooth_along_and_level_across(world):
    for loop in world.trails:
        ahead = np.roll(loop, -1, axis=0) - np.roll(loop, 1, axis=0)
        left = np.stack((-ahead[:, 1], ahead[:, 0]), axis=1) / np.linalg.norm(ahead, axis=1, keepdims=True)
        middle, *sides = (
            read_grid(world.elevation, world.origin, world.resolution, loop + d * left) for d in (0.0, -1.4, 1.4)
        )
        grade = np.degrees(np.arctan((np.roll(middle, -2) - np.roll(middle, 2)) / (4 * SPACING)))
        across = np.degrees(np.arctan((sides[1] - sides[0]) / 2.8))
        assert np.abs(grade).max() < 16
        assert np.percentile(np.abs(across), 95) < 4


def test_uniform_looks_different_everywhere_and_drives_the_same():
    world = make_world(replace(SMALL, preset="uniform"))
    assert np.unique(world.kinds.argmax(axis=0)).size > 3
    mean = property_table().mean(axis=(0, 1))
    np.testing.assert_allclose(world.properties[0, 0], mean, rtol=1e-5)
    assert (world.properties == world.properties[0, 0]).all()  # to the bit: a scaler would blow rounding up


def test_plants_stand_on_the_ground_and_trees_clear_of_trails(world):
    trees, bushes = world.trees, world.bushes
    assert len(bushes.foot) > 20
    for plants in (trees, bushes):
        ground = read_grid(world.elevation, world.origin, world.resolution, plants.foot[:, :2])
        np.testing.assert_allclose(plants.foot[:, 2], ground, atol=1e-4)
    trails = cKDTree(np.concatenate(world.trails))
    if len(trees.foot):
        assert trails.query(trees.foot[:, :2])[0].min() > HALF_WIDTH + TREE_CLEARANCE - 0.05
    near = trails.query(bushes.foot[:, :2])[0]
    assert (near > 0.55 * HALF_WIDTH).all()
    assert (near < HALF_WIDTH + 1.5).any()  # some at the edge
    assert world.grass_height.min() == 0
    assert world.grass_height.max() <= find_world_preset(world.settings.preset).grass_height + 1e-6
    assert world.grass_height.max() > 0.1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"preset": "moon"}, r"no world 'moon'; available: .*mojave"),
        ({"preset": "moon.json"}, r"no world 'moon.json', and no TOML file; give a TOML file, or one of: .*mojave"),
        ({"size": 0.0}, "invalid size = 0.0; choose 60 to 2000 m"),
        ({"size": float("nan")}, "invalid size = nan"),
        ({"grip_contrast": 1.5}, "invalid grip_contrast = 1.5; choose 0 to 1"),
        ({"seed": -1}, "invalid seed = -1; choose 0 or more"),
    ],
)
def test_settings_out_of_range_are_named(change, said):
    with pytest.raises(OffpisteError, match=said) as caught:
        make_world(replace(SMALL, **change))
    assert "\n" not in str(caught.value)
