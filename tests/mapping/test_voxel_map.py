"""Memory of voxels, and behaviour of the map when it moves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from offpiste.core.errors import MapError
from offpiste.mapping.free_space import FreeSpaceSettings
from offpiste.mapping.ghosts import GhostSettings
from offpiste.mapping.voxel_map import VoxelMap, VoxelSettings
from offpiste.mapping.voxels_to_layers import Flattener, FlattenSettings

SMALL = VoxelSettings(reach=6.0, capacity=20_000)
"""30 cells each way."""
PLAIN = FlattenSettings(fill_radius=0.0)


def flatten(held, settings=None):
    return Flattener(held, settings or FlattenSettings()).layers()


def put(held, points, features=None, distance=10.0, has=True):
    """Insert points; features and distances are one for all or one each."""
    points = np.atleast_2d(np.asarray(points, float))
    if features is not None:
        features = np.broadcast_to(np.asarray(features, np.float32), (len(points), held.channels))
    has, distance = np.broadcast_to(has, len(points)), np.broadcast_to(np.asarray(distance, np.float32), len(points))
    held.insert(points, features, has, distance)


def held_at(held, x, y):
    """Features, distance and elevation of the cell at a position."""
    layers = flatten(held, PLAIN)
    column, row = np.round((np.array([x, y]) - layers.origin) / layers.resolution).astype(int)
    return layers.features[row, column].tolist(), float(layers.distance[row, column]), layers.elevation[row, column]


SEEN = ((1.0, 30.0, 0.05), (2.0, 10.0, 0.15), (3.0, 10.0, 0.1), (6.0, 46.0, 0.14))
"""Feature, distance and height of four observations."""


@pytest.mark.parametrize(
    ("rule", "wanted"),
    [("closest", ([2.0], 10.0, 0.15)), ("latest", ([6.0], 46.0, 0.14)), ("average", ([3.0], 24.0, 0.11))],
)
def test_each_rule_keeps_what_its_name_says(rule, wanted):
    """The closest observation stays when the vehicle drives away, and so does the first of equally close ones."""
    held = VoxelMap(1, VoxelSettings(reach=3.0, capacity=100, rule=rule))
    for feature, distance, z in SEEN:
        put(held, [0.1, 0.1, z], [feature], distance)
    assert held_at(held, 0.1, 0.1) == (*wanted[:2], pytest.approx(wanted[2]))


def test_a_closer_point_without_features_moves_the_ground_and_keeps_the_features():
    held = VoxelMap(2, SMALL)
    put(held, [0.1, 0.1, 0.05], [1.0, 2.0], 20.0)
    put(held, [0.1, 0.1, 0.15], [9.0, 9.0], 2.0, has=False)
    put(held, [0.1, 0.1, 0.16], None, 1.0)
    put(held, [0.1, 0.1, 0.17], [np.nan, 9.0], 0.5)
    assert held_at(held, 0.1, 0.1) == ([1.0, 2.0], 20.0, pytest.approx(0.17))


def test_invalid_observations_are_ignored():
    held = VoxelMap(1, SMALL)
    put(held, np.zeros((0, 3)), np.zeros((0, 1)))
    points = np.full((9, 3), 0.1)
    points[0], points[1, 2], points[2, 0], points[3, 1], points[4, 2] = np.nan, np.inf, -np.inf, 1e300, 31.0
    put(held, points[:5], [1.0])
    put(held, points[5:], [1.0], np.array([np.nan, np.inf, -1.0, -np.inf]))
    assert held.occupied == 0
    assert not flatten(held, PLAIN).known.any()
    with pytest.raises(ValueError, match="1 channels, these points 2"):
        held.insert(np.zeros((1, 3)), np.zeros((1, 2), np.float32), np.ones(1, bool), np.ones(1))


@pytest.mark.parametrize(("dx", "dy"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_the_map_ends_at_each_border(dx, dy):
    """6 m each way from a vehicle at the corner of cells; cells that leave the map are lost for good."""
    held = VoxelMap(1, SMALL)
    side = 0.05 * np.array([dy, dx])
    put(held, [*(6.05 * np.array([dx, dy]) + side), 0.1], [1.0])
    assert held.occupied == 0
    put(held, [*(5.95 * np.array([dx, dy]) + side), 0.1], [1.0])
    assert held.occupied == flatten(held, PLAIN).observed.sum() == 1
    held.recentre(-0.2 * np.array([dx, dy], float), 0.0)
    assert held.occupied == 0
    held.recentre(np.zeros(2), 0.0)
    assert not flatten(held, PLAIN).known.any()


def test_the_map_moves_in_whole_cells():
    held = VoxelMap(0, SMALL)
    for x, low in ((0.0, -30), (0.09, -30), (0.11, -29), (-0.09, -30), (-0.11, -31), (1000.0, 4970)):
        held.recentre(np.array([x, 0.0]), 0.0)
        assert held.low.tolist() == [low, -30]
        np.testing.assert_allclose(held.origin, [(low + 0.5) * 0.2, -5.9])
    for place in ([np.nan, 0.0], [np.inf, 0.0], [0.0, 1e9]):
        with pytest.raises(ValueError, match="cannot be centred"):
            held.recentre(np.array(place), 0.0)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(-4, 4), st.floats(-4, 4)), min_size=1, max_size=6), st.integers(0, 1000))
def test_moving_forgets_nothing_inside_and_everything_outside(moves, seed):
    """The map after a drive equals a map built at its end from the observations that never left it."""
    rng = np.random.default_rng(seed)
    held, place = VoxelMap(2, SMALL), np.zeros(2)
    remembered = [np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0)]
    for move in moves:
        place = place + move
        held.recentre(place, 0.0)
        low = np.floor(place * 5 + 0.5) - 30
        points = rng.uniform(-7, 7, (200, 3)) + np.array([*place, 0])
        cloud = [points, rng.normal(size=(200, 2)), rng.uniform(1, 9, 200)]
        put(held, *cloud)
        remembered = [np.concatenate(pair) for pair in zip(remembered, cloud, strict=True)]
        cells = np.floor(remembered[0][:, :2] * 5)
        inside = ((cells >= low) & (cells < low + 60)).all(axis=1)
        remembered = [values[inside] for values in remembered]
    rebuilt = VoxelMap(2, SMALL)
    rebuilt.recentre(place, 0.0)
    put(rebuilt, *remembered)
    assert rebuilt.occupied == held.occupied
    one, other = flatten(held), flatten(rebuilt)
    for name in ("elevation", "features", "distance", "normal", "obstacle_height"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_memory_is_bounded_and_released_voxels_are_used_again():
    held, rng = VoxelMap(1, VoxelSettings(reach=2.0, capacity=1000)), np.random.default_rng(0)
    for step in range(50):
        held.recentre(np.array([5.0 * step, -5.0 * step]), 0.0)
        put(held, rng.uniform(-2, 2, (400, 3)) + np.array([5.0 * step, -5.0 * step, 0]), [1.0])
    assert (held.lost, 300 < held.occupied <= 400) == (0, True)
    held = VoxelMap(1, VoxelSettings(reach=2.0, capacity=100))
    put(held, rng.uniform(-2, 2, (2000, 3)), [1.0])
    assert (held.occupied, held.lost > 1000) == (100, True)
    paper = VoxelMap(40, VoxelSettings())  # 600 x 600 columns
    assert sum(array.nbytes for array in paper.voxels) < 360e6


@pytest.mark.parametrize(
    ("kind", "wrong", "said"),
    [
        (VoxelSettings, {"size": 0.0}, "map settings"), (VoxelSettings, {"reach": float("nan")}, "map settings"),
        (VoxelSettings, {"rule": "best"}, "map settings"), (VoxelSettings, {"capacity": -1}, "map settings"),
        (VoxelSettings, {"reach": 1e5}, "map settings"), (FlattenSettings, {"fill_radius": -0.1}, "radii"),
        (GhostSettings, {"depth": 0.0}, "ghosts"), (GhostSettings, {"sectors": 2}, "ghosts"),
        (GhostSettings, {"rings": 9999}, "ghosts"), (GhostSettings, {"window": 64}, "ghosts"),
        (FreeSpaceSettings, {"times": 0}, "free space"),
    ],
)  # fmt: skip
def test_invalid_settings_are_refused(kind, wrong, said):
    with pytest.raises(MapError, match=said):
        kind(**wrong)
