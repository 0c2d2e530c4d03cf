import msgspec
import numpy as np
import pytest
from scipy.spatial import cKDTree

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.world.vegetation import _apart, grow_grass, plant_bushes, plant_trees
from offpiste.simulation.world.world import BareTerrain, find_world_preset

X = np.arange(-100.0, 101.0, 1.0)
FLAT = np.zeros((len(X), len(X)), np.float32)
FAR = np.full_like(FLAT, 8.0)


def _preset(**changes):
    return msgspec.structs.replace(find_world_preset("halter-ranch"), **changes)


def test_as_many_plants_a_hectare_as_the_preset_says():
    preset = _preset(trees=10.0, bushes=200.0)
    bushes = [
        len(plant_bushes(np.random.default_rng(i), preset, BareTerrain(X, X, FLAT, FAR)).height) for i in range(20)
    ]
    trees = [len(plant_trees(np.random.default_rng(i), preset, BareTerrain(X, X, FLAT, FAR)).height) for i in range(20)]
    assert np.mean(bushes) == pytest.approx(4 * 200, rel=0.2)
    assert np.mean(trees) == pytest.approx(4 * 10, rel=0.3)  # some stood too near to another


def test_trees_stand_apart():
    trees = plant_trees(np.random.default_rng(0), _preset(trees=300.0), BareTerrain(X, X, FLAT, FAR))
    distance, _ = cKDTree(trees.foot).query(trees.foot, k=2)
    assert distance[:, 1].min() >= 3


def test_of_a_row_every_second_is_kept():
    row = np.stack((np.arange(5) * 2.0, np.zeros(5)), axis=1)
    np.testing.assert_array_equal(_apart(row, 3.0), [True, False, True, False, True])


def test_nothing_grows_on_a_trail():
    preset, on_trail = _preset(trees=300.0, bushes=300.0), np.zeros_like(FLAT)
    kinds = np.zeros((len(GROUND_KINDS), *FLAT.shape), np.float32)
    kinds[GROUND_KINDS.index("dry_grass")] = 1
    rng = np.random.default_rng(0)
    assert plant_trees(rng, preset, BareTerrain(X, X, FLAT, on_trail)).foot.shape == (0, 3)
    assert plant_bushes(rng, preset, BareTerrain(X, X, FLAT, on_trail)).foot.shape == (0, 3)
    assert grow_grass(rng, preset, BareTerrain(X, X, FLAT, on_trail), kinds).max() == 0
    share = (grow_grass(rng, preset, BareTerrain(X, X, FLAT, FAR), kinds) > 0.1).mean()
    assert share == pytest.approx(preset.grass, abs=0.2)
