from dataclasses import replace

import numpy as np
import pytest

from offpiste.simulation.driver.route import Route, VisibleTerrain
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


def test_a_route_has_no_gaps(terrain):
    for seed in range(4):
        route = Route(terrain, np.random.default_rng(seed), off_trail=0.5)
        xy = np.array(route.start()[:2])
        for number in range(4000):
            goal = route.ahead(xy, 4.0)
            assert 4.0 <= np.hypot(*(goal - xy)) < 5.5
            xy = xy + 0.2 * (goal - xy) / np.hypot(*(goal - xy))
            if number % 100 == 0:
                assert np.hypot(*np.diff(route._points, axis=0).T).max() < 0.8
                assert len(route._points) < 2000  # what was driven is dropped


def test_the_start_lies_on_a_trail_and_heads_along_it():
    x, y, yaw, climb = Route(circle_terrain(), np.random.default_rng(0), off_trail=0.3).start()
    assert np.hypot(x, y) == pytest.approx(CIRCLE_RADIUS)
    assert abs(np.cos(yaw) * x + np.sin(yaw) * y) < 0.06 * CIRCLE_RADIUS
    assert climb == 0
    climbs = [Route(circle_terrain(0.1), np.random.default_rng(s), off_trail=0.3).start()[3] for s in range(20)]
    assert 0.08 < max(climbs) < 0.101


def test_bend_speed_of_a_circle_and_before_a_bend():
    route = Route(circle_terrain(), np.random.default_rng(0), off_trail=0.0)
    # In the circle v^2 = a r; the first bend counts from 3 m ahead, hence the braking.
    assert route.bend_speed(4.0, 2.0) == pytest.approx(np.sqrt(4.0 * CIRCLE_RADIUS + 2 * 2.0 * 3.0), rel=0.03)
    # A corner of 90 degrees after 18 m of straight.
    line = np.concatenate([np.stack((np.arange(0, 18, 0.5), np.zeros(36)), -1)])
    corner = np.concatenate((line, np.stack((np.full(100, 18.0), np.arange(0, 50, 0.5)), -1)))
    route._points, route._next = corner, 0
    wanted = np.sqrt(4.0 * 3.0 / (np.pi / 2) + 2 * 2.0 * 18.0)
    assert route.bend_speed(4.0, 2.0) == pytest.approx(wanted, rel=0.03)


def test_a_lost_vehicle_finds_another_route(terrain):
    route = Route(terrain, np.random.default_rng(0), off_trail=0.35)
    away = np.array([30.0, 20.0]) - np.sign(np.array(route.start()[:2])) * 60
    away = np.clip(away, -65, 65)
    goal = route.ahead(away, 6.0)
    assert 6.0 <= np.hypot(*(goal - away)) < 8.0
    assert np.hypot(*(route._points[0] - away)) == 0
