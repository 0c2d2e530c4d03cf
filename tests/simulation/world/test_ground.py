import msgspec
import numpy as np
import pytest
from scipy.spatial import cKDTree

from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES
from offpiste.simulation.world.ground import (
    grounds,
    grow_grass,
    mix_properties,
    plant_bushes,
    plant_trees,
    property_table,
)
from offpiste.simulation.world.world import BareTerrain, find_world_preset

K = len(GROUND_KINDS)
X = np.arange(-100.0, 101.0, 1.0)
FLAT = np.zeros((len(X), len(X)), np.float32)
FAR = np.full_like(FLAT, 8.0)


def _shares(seed=0, ny=5, nx=7):
    rng = np.random.default_rng(seed)
    kinds = rng.dirichlet(np.ones(K), (ny, nx)).transpose(2, 0, 1).astype(np.float32)
    return kinds, rng.uniform(size=(ny, nx)).astype(np.float32)


def test_the_table_lies_within_published_ranges():
    dry, wet = property_table()
    for friction, stiffness, rolling, sinkage in np.concatenate((dry, wet)):
        assert 0.2 <= friction <= 0.7
        assert 2.5 <= stiffness <= 8
        assert 0.02 <= rolling <= 0.35
        assert 0 <= sinkage <= 0.15
        assert rolling < friction  # or a vehicle could not move
    assert all(getattr(ground, name).source for ground in grounds() for name in GROUND_PROPERTIES)


def test_pure_ground_has_its_row_of_the_table():
    dry, wet = property_table()
    for k in range(K):
        kinds = np.zeros((K, 1, 3), np.float32)
        kinds[k] = 1
        mixed = mix_properties(kinds, np.array([[0.0, 1.0, 0.25]], np.float32), 1.0)[0]
        np.testing.assert_allclose(mixed, [dry[k], wet[k], 0.75 * dry[k] + 0.25 * wet[k]], rtol=1e-5)


@pytest.mark.parametrize("contrast", [0.0, 0.25, 0.5])
def test_contrast_is_linear_about_the_mean_of_the_table(contrast):
    kinds, wetness = _shares()
    mean = property_table().mean(axis=(0, 1))
    full = mix_properties(kinds, wetness, 1.0)
    np.testing.assert_allclose(mix_properties(kinds, wetness, contrast), mean + contrast * (full - mean), rtol=1e-5)


def _preset(**changes):
    return msgspec.structs.replace(find_world_preset("halter-ranch"), **changes)


def test_as_many_plants_a_hectare_as_the_preset_says():
    preset, bare = _preset(trees=10.0, bushes=200.0), BareTerrain(X, X, FLAT, FAR)
    bushes = [len(plant_bushes(np.random.default_rng(i), preset, bare).height) for i in range(20)]
    trees = [len(plant_trees(np.random.default_rng(i), preset, bare).height) for i in range(20)]
    assert np.mean(bushes) == pytest.approx(4 * 200, rel=0.2)
    assert np.mean(trees) == pytest.approx(4 * 10, rel=0.3)  # some stood too near to another


def test_trees_stand_apart():
    trees = plant_trees(np.random.default_rng(0), _preset(trees=300.0), BareTerrain(X, X, FLAT, FAR))
    distance, _ = cKDTree(trees.foot).query(trees.foot, k=2)
    assert distance[:, 1].min() >= 3


def test_nothing_grows_on_a_trail():
    preset, on_trail = _preset(trees=300.0, bushes=300.0), BareTerrain(X, X, FLAT, np.zeros_like(FLAT))
    kinds = np.zeros((len(GROUND_KINDS), *FLAT.shape), np.float32)
    kinds[GROUND_KINDS.index("dry_grass")] = 1
    rng = np.random.default_rng(0)
    assert plant_trees(rng, preset, on_trail).foot.shape == (0, 3)
    assert plant_bushes(rng, preset, on_trail).foot.shape == (0, 3)
    assert grow_grass(rng, preset, on_trail, kinds).max() == 0
    share = (grow_grass(rng, preset, BareTerrain(X, X, FLAT, FAR), kinds) > 0.1).mean()
    assert share == pytest.approx(preset.grass, abs=0.2)
