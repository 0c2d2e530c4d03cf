"""What a voxel remembers, and what the map forgets when it moves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from offpiste.core.errors import MapError
from offpiste.mapping.voxel_map import VoxelMap, VoxelSettings
from offpiste.mapping.voxels_to_layers import FlattenSettings, flatten

SMALL = VoxelSettings(reach=6.0, capacity=20_000)
"""30 cells each way."""
PLAIN = FlattenSettings(fill_radius=0.0)


def put(held, points, features=None, distance=10.0, has=True):
    """Insert a few points; features and distances one for all or one each."""
    points = np.atleast_2d(np.asarray(points, float))
    if features is not None:
        features = np.broadcast_to(np.asarray(features, np.float32), (len(points), held.channels))
    held.insert(
        points,
        features,
        np.broadcast_to(np.asarray(has), len(points)),
        np.broadcast_to(np.asarray(distance, np.float32), len(points)),
    )


def cell(layers, x, y):
    """Row and column of the cell around a place."""
    column, row = np.round((np.array([x, y]) - layers.origin) / layers.resolution).astype(int)
    return row, column


def held_at(held, x, y):
    """Features, distance and elevation that the map holds in the cell at a place."""
    layers = flatten(held, PLAIN)
    at = cell(layers, x, y)
    return layers.features[at].tolist(), float(layers.distance[at]), float(layers.elevation[at])


def one_place(rule, *observations):
    """Observations (feature, distance, z) of the voxel around (0.1, 0.1, 0.1), in their order."""
    held = VoxelMap(1, VoxelSettings(reach=3.0, capacity=100, rule=rule))
    for feature, distance, z in observations:
        put(held, [0.1, 0.1, z], [feature], distance)
    return held_at(held, 0.1, 0.1)


def test_the_closest_observation_wins_and_stays():
    assert one_place("closest", (1.0, 30.0, 0.05)) == ([1.0], 30.0, pytest.approx(0.05))
    assert one_place("closest", (1.0, 30.0, 0.05), (2.0, 10.0, 0.15)) == ([2.0], 10.0, pytest.approx(0.15))
    # Driving away, the ground is seen from further and further; the memory does not change.
    wanted = ([2.0], 10.0, pytest.approx(0.15))
    assert one_place("closest", (1.0, 30.0, 0.05), (2.0, 10.0, 0.15), (3.0, 11.0, 0.1), (4.0, 40.0, 0.19)) == wanted


def test_of_equally_close_observations_the_first_stays():
    assert one_place("closest", (1.0, 10.0, 0.05), (2.0, 10.0, 0.15))[0] == [1.0]


def test_the_latest_and_the_average_can_be_had_too():
    observations = ((1.0, 30.0, 0.05), (4.0, 9.0, 0.1), (10.0, 21.0, 0.15))
    assert one_place("latest", *observations) == ([10.0], 21.0, pytest.approx(0.15))
    assert one_place("average", *observations) == ([5.0], 20.0, pytest.approx(0.1))


def test_the_closest_of_one_scan_wins_whatever_its_place_in_the_scan():
    for order in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        held = VoxelMap(1, SMALL)
        features, distance = np.array([[1.0], [2.0], [3.0]])[order], np.array([12.0, 7.0, 9.0])[order]
        put(held, np.full((3, 3), 0.1), features, distance)
        assert held_at(held, 0.1, 0.1)[:2] == ([2.0], 7.0)


def test_a_closer_point_without_features_leaves_features_alone():
    held = VoxelMap(2, SMALL)
    put(held, [0.1, 0.1, 0.05], [1.0, 2.0], 20.0)
    put(held, [0.1, 0.1, 0.15], [9.0, 9.0], 2.0, has=False)
    put(held, [0.1, 0.1, 0.16], None, 1.0)
    put(held, [0.1, 0.1, 0.17], [np.nan, 9.0], 0.5)
    # The ground is where it was hit from closest, the look is what was seen.
    assert held_at(held, 0.1, 0.1) == ([1.0, 2.0], 20.0, pytest.approx(0.17))


def test_neighbouring_voxels_do_not_share():
    held = VoxelMap(1, SMALL)
    put(held, [0.1, 0.1, 0.1], [1.0], 5.0)
    put(held, [0.3, 0.1, 0.1], [2.0], 4.0)
    put(held, [0.1, -0.1, 0.1], [3.0], 3.0)
    assert [held_at(held, *xy)[0] for xy in ((0.1, 0.1), (0.3, 0.1), (0.1, -0.1))] == [[1.0], [2.0], [3.0]]
    assert held.occupied == 3


def test_what_is_no_observation_is_left_out():
    held = VoxelMap(1, SMALL)
    put(held, np.zeros((0, 3)), np.zeros((0, 1)))
    points = np.full((9, 3), 0.1)
    points[0], points[1, 2], points[2, 0], points[3, 1] = np.nan, np.inf, -np.inf, 1e300
    points[4, 2] = 31.0
    put(held, points[:5], [1.0])
    put(held, points[5:], [1.0], np.array([np.nan, np.inf, -1.0, -np.inf]))
    assert held.occupied == 0
    assert not flatten(held, PLAIN).known.any()


@pytest.mark.parametrize(("dx", "dy"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_the_map_ends_at_each_border(dx, dy):
    """6 m each way from a vehicle that stands in the corner of cells."""
    held = VoxelMap(1, SMALL)
    side = 0.05 * np.array([dy, dx])
    inside, outside = 5.95 * np.array([dx, dy]) + side, 6.05 * np.array([dx, dy]) + side
    put(held, [*outside, 0.1], [1.0])
    assert held.occupied == 0
    put(held, [*inside, 0.1], [1.0])
    assert held.occupied == 1
    layers = flatten(held, PLAIN)
    assert layers.observed[cell(layers, *inside)]
    # One cell further away the place leaves the map and is forgotten, also when the vehicle comes back.
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
    """The map after a drive is the map rebuilt at its end from the observations that never left."""
    rng = np.random.default_rng(seed)
    held, place = VoxelMap(2, SMALL), np.zeros(2)
    remembered = [np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0)]
    for move in moves:
        place = place + move
        held.recentre(place, 0.0)
        low = np.floor(place * 5 + 0.5) - 30
        cloud = [
            rng.uniform(-7, 7, (200, 3)) + np.array([*place, 0]),
            rng.normal(size=(200, 2)),
            rng.uniform(1, 9, 200),
        ]
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


@given(st.permutations(range(6)))
def test_the_order_of_heights_in_a_column_does_not_matter(order):
    """A column keeps 31 levels from its lowest voxel upwards, whether the crown or the ground was seen first."""
    heights = np.array([-3.1, 0.1, 0.3, 2.9, 3.15, 9.0])
    held = VoxelMap(1, SMALL)
    for i in order:
        put(held, [0.1, 0.1, heights[i]], [i])
    assert held.occupied == 4  # -3.1 ... 2.9: levels -16 to 14; 3.15 is level 15
    assert held_at(held, 0.1, 0.1)[2] == pytest.approx(-3.1)


def test_forgotten_voxels_are_used_again():
    settings = VoxelSettings(reach=2.0, capacity=1000)
    held, rng = VoxelMap(1, settings), np.random.default_rng(0)
    for step in range(50):
        held.recentre(np.array([5.0 * step, -5.0 * step]), 0.0)
        put(held, rng.uniform(-2, 2, (400, 3)) + np.array([5.0 * step, -5.0 * step, 0]), [1.0])
    assert held.lost == 0
    assert 300 < held.occupied <= 400


def test_a_full_map_says_what_it_lost():
    held = VoxelMap(1, VoxelSettings(reach=2.0, capacity=100))
    put(held, np.random.default_rng(0).uniform(-2, 2, (2000, 3)), [1.0])
    assert held.occupied == 100
    assert held.lost > 1000


def test_memory_is_modest():
    """The paper's map, 600 x 600 columns, with every voxel that it may hold."""
    held = VoxelMap(40, VoxelSettings())
    arrays = held.voxels
    assert arrays.heads.shape[:2] == (600, 600)
    whole = sum(array.nbytes for array in arrays)
    assert whole < 360e6
    assert held.nbytes < 60e6


def test_points_at_utm_coordinates_fall_into_the_right_cells():
    far = np.array([654_321.0, 4_567_890.0])
    rng = np.random.default_rng(0)
    points = (np.floor(rng.uniform(-2, 2, (50, 3)) * 5) + 0.5) / 5
    near, away = VoxelMap(1, SMALL), VoxelMap(1, SMALL)
    away.recentre(far, 0.0)
    put(near, points, np.arange(50.0)[:, None])
    put(away, points + np.array([*far, 0.0]), np.arange(50.0)[:, None])
    one, other = flatten(near, PLAIN), flatten(away, PLAIN)
    np.testing.assert_array_equal(one.features, other.features)
    np.testing.assert_allclose(one.elevation, other.elevation, atol=1e-6)


def test_settings_that_make_no_sense_are_refused():
    for wrong in ({"size": 0.0}, {"reach": float("nan")}, {"rule": "best"}, {"capacity": -1}, {"reach": 1e5}):
        with pytest.raises(MapError, match="map settings"):
            VoxelSettings(**wrong)
    with pytest.raises(MapError, match="radii"):
        FlattenSettings(fill_radius=-0.1)
    held = VoxelMap(2, SMALL)
    with pytest.raises(ValueError, match="2 channels, these points 1"):
        held.insert(np.zeros((1, 3)), np.zeros((1, 1), np.float32), np.ones(1, bool), np.ones(1))
