"""Forks: two ways of equal length, one of them through mud."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.forks import ASIDE, HALF_WIDTH, LENGTH, MUD, WAVE, WEAVE, WETNESS, fork_trails
from offpiste.simulation.world.grids import read_grid
from offpiste.simulation.world.world import WorldSettings

SPACING = 0.5
SETTINGS = WorldSettings("mojave", seed=3, resolution=0.5, forks=True)


def ring(radius, straight=0.0):
    """Closed loop of two half circles with straight pieces between, counter-clockwise from the lower one's start."""
    angle = np.arange(0, np.pi, SPACING / radius)
    bend = radius * np.stack((np.sin(angle), -np.cos(angle)), axis=1)
    along = np.arange(-straight / 2, straight / 2, SPACING)
    lower = np.stack((along, np.full_like(along, -radius)), axis=1)
    half = np.concatenate((lower, bend + np.array((straight / 2, 0.0))))
    return np.concatenate((half, -half))


def test_the_ways_by_hand():
    loop = ring(30.0, straight=100.0)
    (forked, island), (fork,) = fork_trails(np.random.default_rng(0), (loop,), SPACING)
    middle = (fork.left + fork.right) / 2
    start = int(np.argmin(np.linalg.norm(loop - fork.left[0], axis=1)))
    np.testing.assert_allclose(middle, np.roll(loop, -start, axis=0)[: len(middle)], atol=1e-9)
    assert np.ptp(middle[:, 1]) == pytest.approx(0, abs=1e-9), "on a straight piece: only there are both alike"
    share = np.linspace(0, 1, len(middle))
    apart = np.linalg.norm(fork.left - fork.right, axis=1)
    beside = ASIDE + WEAVE * np.sin(2 * np.pi * LENGTH / WAVE * share)
    np.testing.assert_allclose(apart, 2 * beside * np.sin(np.pi * share) ** 2, atol=1e-9)
    ahead, aside = middle[1] - middle[0], fork.left[60] - middle[60]
    assert ahead[0] * aside[1] - ahead[1] * aside[0] > 0, "to the left of the direction of driving"
    np.testing.assert_array_equal(forked[: len(fork.left)], fork.left)
    assert len(forked) == len(loop)
    assert np.linalg.norm(np.diff(forked, axis=0, append=forked[:1]), axis=1).max() < 1.2 * SPACING
    np.testing.assert_array_equal(island[: len(fork.right)], fork.right)
    np.testing.assert_array_equal(np.concatenate((island[len(fork.right) :], island[:1])), fork.left[-2::-1])


def test_no_fork_beside_another_trail_or_on_a_short_one():
    rng, loop = np.random.default_rng(0), ring(30.0, straight=100.0)
    for trails in ((loop, ring(36.0, straight=100.0)), (ring(20.0),)):
        same, forks = fork_trails(rng, trails, SPACING)
        assert not forks
        assert all(one is other for one, other in zip(same, trails, strict=True))


def test_one_way_is_mud_and_the_other_firm():
    world = make_world(SETTINGS)
    assert len(world.forks) > 1
    assert len(world.trails) == len(make_world(replace(SETTINGS, forks=False)).trails) + len(world.forks)
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


def test_far_from_the_trails_all_stays_as_it_was():
    world, plain = make_world(SETTINGS), make_world(replace(SETTINGS, forks=False))
    y, x = np.indices(world.elevation.shape) * world.resolution
    nodes = np.stack((x + world.origin[0], y + world.origin[1]), axis=-1)
    trails = np.concatenate([*world.trails, *plain.trails])
    far = cKDTree(trails).query(nodes)[0] > 4 * HALF_WIDTH
    assert far.mean() > 0.3
    assert np.abs(world.kinds - plain.kinds)[:, far].mean() < 1e-3, "wetness depends on the mean height"
    assert np.abs(world.elevation - plain.elevation)[far].mean() < 0.01
    again = make_world(SETTINGS)
    for name in ("elevation", "kinds", "wetness", "properties"):
        assert getattr(again, name).tobytes() == getattr(world, name).tobytes()
