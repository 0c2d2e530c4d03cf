import numpy as np
import pytest

from offpiste.simulation.rendering.scene import SURFACES, Scene, box_mesh, world_scene
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


def test_a_trunk_stops_rays_and_is_named():
    scene = world_scene(scenes.world(trees=scenes.tree(8.0, 0.0, radius=0.3)))
    hits = scene.cast(np.array([[0.0, 0.0, 0.5]]), np.array([[1.0, 0.0, 0.0]]))
    assert hits.surface[0] == SURFACES.index("trunk")
    assert hits.distance[0] == pytest.approx(8.0 - 0.3, abs=0.07)
    assert hits.normal[0, 0] < -0.8


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


def test_nearer_hits_are_kept():
    box = np.array([[[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]])
    origins, directions = np.array([[-5.0, 0, 0], [-5.0, 0, 3.0]]), np.array([[1.0, 0, 0], [1.0, 0, 0]])
    own = Scene([box_mesh(box)]).cast(origins, directions)
    hits = Scene([box_mesh(box * [1, 9, 9] + [3, 0, 0])]).cast(origins, directions, own)
    np.testing.assert_allclose(hits.distance, [4.0, 7.0], atol=1e-5)
