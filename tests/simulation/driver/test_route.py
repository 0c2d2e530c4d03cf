"""Routes and hazards along arcs."""

from dataclasses import replace

import numpy as np
import pytest

from offpiste.simulation.driver.route import FAR, Route, VisibleTerrain, hazards_along_arcs
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings
from simulation.drives import flat_world

CIRCLE_RADIUS = 20.0


def circle_terrain(slope: float = 0.0) -> VisibleTerrain:
    angle = np.arange(0, 2 * np.pi, 0.5 / CIRCLE_RADIUS)
    circle = CIRCLE_RADIUS * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return replace(VisibleTerrain.of(flat_world(slope=slope)), trails=(circle,))


@pytest.fixture(scope="module")
def terrain() -> VisibleTerrain:
    return VisibleTerrain.of(make_world(WorldSettings("mojave", seed=1, size=160.0, resolution=0.5)))


def driven(terrain: VisibleTerrain, seed: int, metres: float, off_trail: float = 0.35) -> np.ndarray:
    """Path of a point that moves towards the route's point 5 m ahead."""
    route = Route(terrain, np.random.default_rng(seed), off_trail=off_trail)
    xy, path = np.array(route.start()[:2]), []
    while len(path) * 0.25 < metres:
        goal = route.ahead(xy, 5.0)
        xy = xy + 0.25 * (goal - xy) / np.hypot(*(goal - xy))
        path.append(xy)
    return np.array(path)


def test_a_route_is_endless_inside_the_world_and_covers_it(terrain):
    path = driven(terrain, 0, 1500.0)
    assert np.abs(path).max() < 80 - 10
    # Farther than one loop of trail: it comes to other parts of the world.
    visited = {(int(x // 20), int(y // 20)) for x, y in path}
    assert len(visited) > 15


def test_the_start_lies_on_a_trail_and_heads_along_it():
    x, y, yaw, climb = Route(circle_terrain(), np.random.default_rng(0), off_trail=0.3).start()
    assert np.hypot(x, y) == pytest.approx(CIRCLE_RADIUS)
    assert abs(np.cos(yaw) * x + np.sin(yaw) * y) < 0.06 * CIRCLE_RADIUS
    assert climb == 0
    climbs = [Route(circle_terrain(0.1), np.random.default_rng(s), off_trail=0.3).start()[3] for s in range(20)]
    assert 0.08 < max(climbs) < 0.101


SIZE = (2.0, 1.2, 1.5)
"""Wheelbase, track, middle to nose."""


def hazards_from(world, *, x=0.0, y=0.0, yaw=0.0, length=10.0, curvatures=(0.0,), margin=8.0):
    return hazards_along_arcs(VisibleTerrain.of(world), np.array(curvatures), (x, y, yaw), length, SIZE, margin)


def test_an_arc_ends_where_a_circle_does():
    curvatures = np.array([-0.2, 0.0, 0.05, 0.2])
    hazards = hazards_from(flat_world(), x=3.0, y=-2.0, yaw=0.7, length=12.0, curvatures=curvatures)
    turn = curvatures * 12
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = np.where(curvatures == 0, 12.0, np.sin(turn) / curvatures)
        left = np.where(curvatures == 0, 0.0, (1 - np.cos(turn)) / curvatures)
    c, s = np.cos(0.7), np.sin(0.7)
    # Chords are shorter than arcs: by 1 - sinc of half a step's turn.
    np.testing.assert_allclose(
        hazards.end, np.stack((3 + c * ahead - s * left, -2 + s * ahead + c * left), -1), atol=0.01
    )


@pytest.mark.parametrize(
    ("yaw", "climb", "descent", "lean"), [(0.0, 0.2, 0.0, 0.1), (np.pi, 0.0, 0.2, 0.1), (np.pi / 2, 0.1, 0.0, 0.2)]
)
def test_a_plane_is_climbed_or_leaned_on(yaw, climb, descent, lean):
    hazards = hazards_from(flat_world(slope=0.2, side_slope=0.1), yaw=yaw)
    for value, wanted in (
        (hazards.climb, climb),
        (hazards.descent, descent),
        (hazards.lean, lean),
        (hazards.vertical_curvature, 0.0),
    ):
        np.testing.assert_allclose(value, [wanted], atol=1e-6)
    np.testing.assert_allclose(hazards.protrusion, [0.0], atol=1e-6)


def test_a_ridge_touches_the_belly_and_a_wall_the_nose():
    # A roof along y, 30 % steep, its ridge at x = 6: with the axles 1 m to both sides the ridge is 0.3 m above them.
    ridge = flat_world(bumps=lambda x: -0.3 * np.abs(x - 6.0), resolution=0.25)
    np.testing.assert_allclose(hazards_from(ridge, length=12.0).protrusion, [0.3], atol=0.05)
    wall = flat_world(bumps=lambda x: np.where(x > 9.0, 1.0, 0.0), resolution=0.25)
    # The nose is at 7 + 1.5 m while all wheels still stand before the wall.
    assert hazards_from(wall, length=7.0).protrusion[0] < 0.01
    assert hazards_from(wall, length=8.5).protrusion[0] > 0.5


def test_trees_and_the_border_count():
    world = flat_world(trees=[(6.0, 0.0, 0.25), (300.0, 0.0, 0.5)])
    hazards = hazards_from(world, curvatures=(0.0, 0.2))
    np.testing.assert_allclose(hazards.clearance[0], -0.25, atol=0.31)  # points are 0.6 m apart
    assert hazards.clearance[1] > 1.5
    assert hazards_from(flat_world()).clearance[0] == FAR
    assert hazards_from(world, x=50.0).clearance[0] == FAR
    assert hazards_from(world, y=0.0).border_overlap[0] == 0.0
    np.testing.assert_allclose(
        hazards_from(world, y=45.0, yaw=np.pi / 2).border_overlap, [3.0], atol=0.01
    )  # border at 60 m
    np.testing.assert_allclose(hazards_from(world, x=-100.0, yaw=np.pi, length=20.0).border_overlap, [8.0], atol=0.01)
