"""Ray casting against formulas, and packets against single rays."""

import ctypes

import numpy as np
import pytest

from offpiste.simulation.rendering.embree import Mesh, RayPackets, SingleRays, _library
from offpiste.simulation.rendering.scene import SURFACES, ground_mesh, world_scene
from simulation import scenes


def _rays(n=500, seed=0):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(-3, 3, (n, 3)) + np.array([0, 0, 6]), directions


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, 0.0), (0.0, -0.2), (0.1, 0.25)])
def test_rays_meet_a_plane_where_the_formula_says(slope):
    scene = world_scene(scenes.world(size=200, resolution=4.0, slope=slope))
    origins, directions = _rays()
    hits = scene.cast(origins, directions)
    # n . (o + t d) = 0 with n = (-a, -b, 1)
    up = np.array([-slope[0], -slope[1], 1.0])
    expected = -(origins @ up) / (directions @ up)
    near = (expected > 0) & (expected < 80)
    assert near.sum() > 100
    np.testing.assert_allclose(hits.distance[near], expected[near], rtol=1e-4)
    np.testing.assert_allclose(hits.normal[near], np.tile(up / np.linalg.norm(up), (near.sum(), 1)), atol=1e-5)
    assert (hits.surface[near] == SURFACES.index("ground")).all()
    missed = expected < 0
    assert np.isinf(hits.distance[missed]).all()
    assert (hits.surface[missed] == SURFACES.index("sky")).all()
    assert (hits.item[missed] == -1).all()


def test_hits_do_not_depend_on_how_rays_are_split():
    world = scenes.world(trees=scenes.tree(5.0, 0.0), bushes=scenes.bush(3.0, 2.0), grass=0.4)
    origins, directions = _rays(40_000)
    one, two = (world_scene(world, threads=n).cast(origins, directions) for n in (1, 3))
    for name in vars(one):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert set(np.unique(one.surface)) >= {SURFACES.index(name) for name in ("sky", "ground", "crown", "grass")}


def test_tall_grass_hides_the_ground_from_far_and_shows_it_from_above():
    scene = world_scene(scenes.world(grass=0.5))
    ground, grass = SURFACES.index("ground"), SURFACES.index("grass")
    rng = np.random.default_rng(1)
    places = np.column_stack((rng.uniform(-10, 10, (2000, 2)), np.full(2000, 2.0)))
    steep = scene.cast(places, np.tile([[0.0, 0.0, -1.0]], (2000, 1)))
    angle = rng.uniform(0, 2 * np.pi, 2000)
    grazing = np.column_stack((np.cos(angle), np.sin(angle), np.full(2000, -0.15)))
    flat = scene.cast(places * [0.2, 0.2, 1], grazing)
    assert (steep.surface == ground).mean() > 0.6
    assert (flat.surface == grass).mean() > 0.6


def parts(quadrilaterals):
    rng = np.random.default_rng(0)
    soup = rng.normal(size=(200, 1, 3)) * np.array((20, 20, 1)) + rng.normal(size=(200, 3, 3))
    faces = np.arange(600, dtype=np.int32).reshape(-1, 3)
    triangles = Mesh("crown", soup.reshape(-1, 3).astype(np.float32), faces, np.arange(200))
    ground = ground_mesh(scenes.world(size=80, resolution=2.0, slope=(0.1, 0.2)))
    return [ground, triangles] if quadrilaterals else [triangles]


def rays(n, *, one_origin):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(n, 3)).astype(np.float32)
    origins = rng.uniform(-20, 20, (1 if one_origin else n, 3)) + np.array((0, 0, 12))
    return origins.astype(np.float32), directions


def none(n, farthest=np.inf):
    """Distance, part, face and normal before a cast."""
    return np.full(n, farthest, np.float32), *np.full((2, n), -7, np.int32), np.zeros((n, 3), np.float32)


@pytest.mark.parametrize("n", [1, 7, 16, 1003])
@pytest.mark.parametrize("one_origin", [True, False])
@pytest.mark.parametrize("farthest", [np.inf, 25.0])
def test_packets_hit_what_single_rays_hit(n, one_origin, farthest):
    library = _library()
    if library is None:
        pytest.skip("embreex does not bring Embree as a file here")
    origins, directions = rays(n, one_origin=one_origin)
    for quadrilaterals in (False, True):
        single, packets = SingleRays(parts(quadrilaterals)), RayPackets(parts(quadrilaterals), library)
        expected, hits = none(n, farthest), none(n, farthest)
        single.intersect(origins, directions, *expected)
        packets.intersect(origins, directions, *hits)
        part = hits[1]
        for k in (1, 2):
            np.testing.assert_array_equal(hits[k], expected[k])
        # A quadrilateral's second triangle is given by other corners than embreex's.
        np.testing.assert_allclose(hits[0], expected[0], rtol=2e-6 if quadrilaterals else 0)
        np.testing.assert_allclose(hits[3], expected[3], rtol=1e-5 if quadrilaterals else 0)
        np.testing.assert_array_equal(packets.occluded(origins, directions), single.occluded(origins, directions))
        if n > 1000 and not one_origin:
            assert 0.01 < (part >= 0).mean() < 0.99
            assert (np.unique(part[part >= 0]) == np.arange(1 + quadrilaterals)).all()


def test_scenes_that_do_not_fit_into_memory_are_refused():
    class Full(ctypes.CDLL):
        """Embree's library when memory runs out."""

        def __init__(self):
            pass

        def __getattr__(self, name):
            return lambda *_: 2

    with pytest.raises(MemoryError, match="cannot build"):
        RayPackets([], Full())
