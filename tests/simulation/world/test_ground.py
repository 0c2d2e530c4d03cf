"""Kinds of ground, plants and forks."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.forks import MUD, WETNESS
from offpiste.simulation.world.grids import read_grid
from offpiste.simulation.world.ground import grow_grass, mix_properties, plant_bushes, plant_trees, property_table
from offpiste.simulation.world.world import BareTerrain, WorldSettings, find_world_preset

K = len(GROUND_KINDS)
X = np.arange(-100.0, 101.0, 1.0)
FLAT = np.zeros((len(X), len(X)), np.float32)
FAR = np.full_like(FLAT, 8.0)


def test_pure_ground_has_its_row_of_the_table():
    dry, wet = property_table()
    for k in range(K):
        kinds = np.zeros((K, 1, 3), np.float32)
        kinds[k] = 1
        mixed = mix_properties(kinds, np.array([[0.0, 1.0, 0.25]], np.float32), 1.0)[0]
        np.testing.assert_allclose(mixed, [dry[k], wet[k], 0.75 * dry[k] + 0.25 * wet[k]], rtol=1e-5)


def _preset(**changes):
    return msgspec.structs.replace(find_world_preset("halter-ranch"), **changes)


def test_as_many_plants_a_hectare_as_the_preset_says():
    preset, bare = _preset(trees=10.0, bushes=200.0), BareTerrain(X, X, FLAT, FAR)
    bushes = [len(plant_bushes(np.random.default_rng(i), preset, bare).height) for i in range(20)]
    trees = [len(plant_trees(np.random.default_rng(i), preset, bare).height) for i in range(20)]
    assert np.mean(bushes) == pytest.approx(4 * 200, rel=0.2)
    assert np.mean(trees) == pytest.approx(4 * 10, rel=0.3)  # some stood too near to another


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


def test_one_way_is_mud_and_the_other_firm():
    settings = WorldSettings("mojave", seed=3, resolution=0.5, forks=True)
    world = make_world(settings)
    assert len(world.forks) > 1
    assert len(world.trails) == len(make_world(replace(settings, forks=False)).trails) + len(world.forks)
    np.testing.assert_allclose(world.kinds.sum(axis=0), 1, atol=1e-5)
    kinds = np.moveaxis(world.kinds, 0, -1)
    for fork in world.forks:
        ways, count = (fork.left, fork.right), len(fork.left)
        inside = slice(round((MUD[0] + 0.05) * count), round((MUD[1] - 0.05) * count))
        mud = read_grid(kinds, world.origin, world.resolution, ways[fork.muddy][inside])
        firm = read_grid(kinds, world.origin, world.resolution, ways[1 - fork.muddy])
        assert mud[:, GROUND_KINDS.index("mud")].min() > 0.99
        assert firm[:, GROUND_KINDS.index("dirt_trail")].min() > 0.99
        wetness = read_grid(world.wetness, world.origin, world.resolution, ways[fork.muddy][inside])
        np.testing.assert_allclose(wetness, WETNESS, atol=1e-3)
