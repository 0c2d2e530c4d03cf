"""Ray casting against formulas."""

import numpy as np
import pytest

from offpiste.simulation.rendering.embree import Mesh, RayCaster
from offpiste.simulation.rendering.scene import SURFACES, Hits, ground_mesh, world_scene
from simulation import scenes


def _rays(n=500, seed=0):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(-3, 3, (n, 3)) + np.array([0, 0, 6]), directions


# Fewer rays than a packet, a full packet, and several; each with its own or a common origin.
@pytest.mark.parametrize(("n", "one_origin"), [(1, False), (7, True), (16, False), (1003, True), (1003, False)])
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, -0.2)])
def test_rays_meet_a_plane_where_the_formula_says(slope, n, one_origin):
    scene = world_scene(scenes.world(size=200, resolution=4.0, slope=slope))
    origins, directions = _rays(n)
    origins = origins[:1] if one_origin else origins
    hits = scene.cast(origins, directions)
    # n . (o + t d) = 0 with n = (-a, -b, 1)
    up = np.array([-slope[0], -slope[1], 1.0])
    expected = -(origins @ up) / (directions @ up)
    near, missed = (expected > 0) & (expected < 80), expected < 0
    assert n < 1000 or near.sum() > 200 < missed.sum()
    np.testing.assert_allclose(hits.distance[near], expected[near], rtol=1e-4)
    np.testing.assert_allclose(hits.normal[near], np.tile(up / np.linalg.norm(up), (near.sum(), 1)), atol=1e-5)
    assert (hits.surface[near] == SURFACES.index("ground")).all()
    assert np.isinf(hits.distance[missed]).all()
    assert (hits.surface[missed] == SURFACES.index("sky")).all()
    assert (hits.item[missed] == -1).all()
    if not one_origin:
        np.testing.assert_array_equal(scene.occluded(origins, directions)[near | missed], near[near | missed])


def test_the_nearest_of_several_meshes_is_hit_up_to_the_farthest_distance():
    high = Mesh(
        "crown", np.array([[-9, -9, 2], [9, -9, 2], [0, 9, 2]], np.float32), np.array([[0, 1, 2]]), np.zeros(1, int)
    )
    caster = RayCaster([ground_mesh(scenes.world(size=80, resolution=2.0)), high])
    origins = np.array([[0, 0, 3], [20, 0, 3], [0, 0, 1], [20, 0, 9]], np.float32)
    directions = np.tile(np.array((0, 0, -1), np.float32), (4, 1))
    distance, part, face = np.full(4, 5.0, np.float32), np.zeros(4, np.int32), np.zeros(4, np.int32)
    caster.intersect(origins, directions, distance, part, face, np.zeros((4, 3), np.float32))
    np.testing.assert_array_equal(part, [1, 0, 0, -1])
    np.testing.assert_allclose(distance, [1, 3, 1, 5])


def test_hits_do_not_depend_on_how_rays_are_split():
    world = scenes.world(trees=scenes.tree(5.0, 0.0), bushes=scenes.bush(3.0, 2.0), grass=0.4)
    origins, directions = _rays(40_000)
    one, two = (world_scene(world, threads=n).cast(origins, directions) for n in (1, 3))
    for name in vars(one):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert set(np.unique(one.surface)) >= {SURFACES.index(name) for name in ("sky", "ground", "crown", "grass")}


def test_tall_grass_hides_the_ground_from_far_and_shows_it_from_above():
    scene = world_scene(scenes.world(grass=0.5))
    rng = np.random.default_rng(1)
    places = np.column_stack((rng.uniform(-10, 10, (2000, 2)), np.full(2000, 2.0)))
    steep = scene.cast(places, np.tile([[0.0, 0.0, -1.0]], (2000, 1)))
    angle = rng.uniform(0, 2 * np.pi, 2000)
    flat = scene.cast(places * [0.2, 0.2, 1], np.column_stack((np.cos(angle), np.sin(angle), np.full(2000, -0.15))))
    assert (steep.surface == SURFACES.index("ground")).mean() > 0.6
    assert (flat.surface == SURFACES.index("grass")).mean() > 0.6


def test_hits_of_a_part_are_not_changed_by_a_cast():
    scene, (origins, directions) = world_scene(scenes.world()), _rays(40)
    before = Hits.none(40)
    found = scene.cast(origins, directions, before.part(slice(None)))
    assert np.isfinite(found.distance).any()
    assert np.isinf(before.distance).all()


def test_rays_and_results_of_other_lengths_are_refused():
    caster, rays = RayCaster([ground_mesh(scenes.world())]), np.ones((5, 3), np.float32)
    results = np.ones(5, np.float32), np.zeros(5, np.int32), np.zeros(5, np.int32), np.zeros((5, 3), np.float32)
    for origins, given in ((rays[:2], results), (rays, (*results[:3], rays[1:]))):
        with pytest.raises(ValueError, match="5 rays"):
            caster.intersect(origins, rays, *given)
    with pytest.raises(ValueError, match="5 rays"):
        caster.occluded(rays[:2], rays)
