"""From voxels to layers, each rule alone, with answers worked out by hand."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from offpiste.mapping.terrain_sampler import MapTerrain, sample_maps, stack_maps
from offpiste.mapping.voxel_map import VoxelMap, VoxelSettings
from offpiste.mapping.voxels_to_layers import Flattener, FlattenSettings, flatten, neighbour_offsets

SMALL = VoxelSettings(reach=6.0, capacity=20_000)
N = 30


def put(held, points, features=None, distance=10.0):
    points = np.atleast_2d(np.asarray(points, float))
    if features is not None:
        features = np.broadcast_to(np.asarray(features, np.float32), (len(points), held.channels))
    has = np.full(len(points), features is not None)
    held.insert(points, features, has, np.broadcast_to(np.asarray(distance, np.float32), len(points)))


def column(heights, **options):
    """The layers' cell at (0.1, 0.1) with hits at heights, features being their numbers (None: a hit without any)."""
    held = VoxelMap(1, SMALL)
    for number, z in heights:
        put(held, [0.1, 0.1, z], None if number is None else [number])
    layers = flatten(held, FlattenSettings(**options))
    assert layers.known.sum() == 13  # itself, and the 12 neighbours within 0.4 m that it fills
    return {
        name: getattr(layers, name)[N, N].tolist() for name in ("elevation", "obstacle_height", "features", "valid")
    }


def ground(rise_x, rise_y, *, scatter=0.0, keep=1.0, seed=0, channels=1):
    """A plane hit once in each cell, up to `scatter` from its centre, with `keep` of the hits."""
    rng = np.random.default_rng(seed)
    held = VoxelMap(channels, SMALL)
    centres = (np.mgrid[-N:N, -N:N].reshape(2, -1).T + 0.5) * 0.2
    xy = centres + rng.uniform(-scatter, scatter, centres.shape)
    points = np.column_stack((xy, rise_x * xy[:, 0] + rise_y * xy[:, 1] + 0.03))
    points = points[rng.random(len(points)) < keep]
    put(held, points, points[:, :1] @ np.ones((1, channels)))
    return held


# --- lowest valid ----------------------------------------------------------------------------------------------------
def test_the_lowest_voxel_is_the_ground_and_gives_the_features():
    found = column([(1, 0.1), (2, 0.7), (3, 1.5)])
    assert found == {
        "elevation": pytest.approx(0.1),
        "obstacle_height": pytest.approx(1.4),
        "features": [1.0],
        "valid": True,
    }


def test_the_lowest_voxel_with_features_gives_them_while_it_lies_within_half_a_metre_of_the_ground():
    assert column([(None, 0.1), (2, 0.55), (3, 0.9)])["features"] == [2.0]
    assert column([(None, 0.1), (2, 0.59)])["valid"]
    assert not column([(None, 0.1), (2, 0.61)])["valid"]
    assert np.isnan(column([(None, 0.1), (2, 0.61)])["features"])
    assert column([(None, 0.1), (2, 0.61)], feature_height=0.6)["valid"]


def test_ground_found_lower_makes_features_above_it_invalid():
    held = VoxelMap(1, SMALL)
    put(held, [0.1, 0.1, 1.0], [1.0])
    assert flatten(held).valid[N, N]
    put(held, [0.1, 0.1, 0.1])  # below the bush
    layers = flatten(held)
    assert not layers.valid[N, N]
    assert layers.elevation[N, N] == pytest.approx(0.1)
    put(held, [0.1, 0.1, 0.12], [7.0])
    assert flatten(held).features[N, N] == 7


def test_obstacles_reach_up_to_the_vehicles_height_and_branches_are_driven_under():
    assert column([(1, 0.1), (2, 2.05)])["obstacle_height"] == pytest.approx(1.95)
    assert column([(1, 0.1), (2, 2.15)])["obstacle_height"] == 0
    assert column([(1, 0.1), (2, 1.0), (3, 2.15), (4, 4.5)])["obstacle_height"] == pytest.approx(0.9)
    assert column([(1, 0.1), (2, 2.15)], vehicle_height=2.1)["obstacle_height"] == pytest.approx(2.05)


def test_a_branch_beside_ground_is_not_ground():
    """A column with no hit but a branch 3 m up takes the ground of its neighbour."""
    held = VoxelMap(1, SMALL)
    put(held, [0.1, 0.1, 0.1], [1.0])
    put(held, [0.3, 0.1, 3.1], [2.0])
    layers = flatten(held)
    assert layers.elevation[N, N + 1] == pytest.approx(0.1)
    assert layers.features[N, N + 1] == 1
    assert layers.known[N, N + 1]
    assert not layers.observed[N, N + 1]
    # A step of 1.9 m is ground: the vehicle cannot go under it.
    put(held, [0.3, 0.1, 1.9], [3.0])
    layers = flatten(held)
    assert layers.elevation[N, N + 1] == pytest.approx(1.9)
    assert layers.observed[N, N + 1]


def test_branches_are_told_from_ground_up_to_a_metre_away():
    for cells, is_ground in ((5, False), (6, True)):
        held = VoxelMap(1, SMALL)
        put(held, [0.1, 0.1, 0.1], [1.0])
        put(held, [0.1 + 0.2 * cells, 0.1, 3.1], [2.0])
        assert flatten(held).observed[N, N + cells] == is_ground


def test_forty_degrees_are_ground():
    steep = float(np.tan(np.radians(40)))
    for rise in ((steep, 0.0), (steep / np.sqrt(2), -steep / np.sqrt(2))):
        assert flatten(ground(*rise)).observed.all()


# --- gaps ------------------------------------------------------------------------------------------------------------
def test_gaps_are_filled_up_to_0_4_m_and_not_at_0_5():
    held = VoxelMap(1, SMALL)
    put(held, [0.1, 0.1, 0.13], [5.0], 7.0)
    layers = flatten(held)
    away = np.hypot(*(np.mgrid[-N:N, -N:N] * 0.2))
    np.testing.assert_array_equal(layers.known, away < 0.4 + 1e-9)
    np.testing.assert_array_equal(layers.valid, layers.known)
    assert layers.observed.sum() == 1
    filled = layers.known & ~layers.observed
    assert filled.sum() == 12
    np.testing.assert_allclose(layers.elevation[filled], 0.13, atol=1e-6)
    assert (layers.features[filled] == 5).all()
    assert (layers.distance[filled] == 7).all()
    np.testing.assert_array_equal(layers.unknown, ~layers.known)
    # (0.3, 0.4) m is 0.5 m away.
    wide = flatten(one_hit(0.1, [0.05, 0.05, 0.1]), FlattenSettings(fill_radius=0.4))
    assert wide.known[N, N + 4]
    assert not wide.known[N, N + 5]
    assert not wide.known[N + 3, N + 4]
    assert flatten(one_hit(0.1, [0.05, 0.05, 0.1]), FlattenSettings(fill_radius=0.5)).known[N + 3, N + 4]


def one_hit(size, point):
    held = VoxelMap(1, VoxelSettings(size=size, reach=30 * size, capacity=100))
    put(held, point, [1.0])
    return held


def test_the_nearest_cell_fills_and_of_equally_near_ones_the_lower_y_then_the_lower_x():
    places = {(-2, 0): 1.0, (0, 1): 2.0}  # columns and rows from a gap
    assert filled_from(places) == 2
    assert filled_from({(1, 0): 1.0, (-1, 0): 2.0}) == 2
    assert filled_from({(0, 1): 1.0, (0, -1): 2.0}) == 2
    assert filled_from({(-1, 0): 1.0, (0, -1): 2.0}) == 2
    assert filled_from({(1, 0): 1.0, (0, 1): 2.0}) == 1
    assert neighbour_offsets(1.0).tolist() == [[0, 0], [-1, 0], [0, -1], [0, 1], [1, 0]]


def filled_from(places):
    held = VoxelMap(1, SMALL)
    for (right, up), feature in places.items():
        put(held, [0.1 + 0.2 * right, 0.1 + 0.2 * up, 0.1], [feature])
    layers = flatten(held)
    assert layers.valid[N, N]
    assert not layers.observed[N, N]
    return float(layers.features[N, N, 0])


def test_features_fill_a_hit_without_any_but_not_from_another_height():
    held = VoxelMap(1, SMALL)
    put(held, [0.1, 0.1, 0.1])
    put(held, [0.3, 0.1, 0.7], [1.0])  # nearest, but 0.6 m higher
    put(held, [0.1, 0.5, 0.5], [2.0])
    layers = flatten(held)
    assert layers.observed[N, N]
    assert layers.elevation[N, N] == pytest.approx(0.1)
    assert layers.features[N, N] == 2


def test_an_empty_map_stays_invalid():
    layers = flatten(VoxelMap(2, SMALL))
    assert not (layers.known | layers.observed | layers.valid).any()
    for name in ("elevation", "normal", "slope", "roughness", "obstacle_height", "features", "distance"):
        assert np.isnan(getattr(layers, name)).all()


def test_layers_written_over_are_as_good_as_new():
    held, rng = VoxelMap(2, SMALL), np.random.default_rng(0)
    flattener, layers = Flattener(held, FlattenSettings()), None
    for step in range(4):
        held.recentre(np.array([2.5 * step, 0.0]), 0.0)
        put(held, rng.uniform(-6, 6, (300, 3)) + np.array([2.5 * step, 0, 0]), rng.normal(size=(300, 2)))
        layers = flattener.layers(layers)
        for name, value in vars(flatten(held)).items():
            np.testing.assert_array_equal(getattr(layers, name), value)


def test_heights_are_the_worlds_after_the_vehicle_rose():
    held = VoxelMap(0, SMALL)
    put(held, np.array([[0.5, 0.5, 0.0]]))
    flattener = Flattener(held, FlattenSettings())
    flattener.layers()
    held.recentre(np.zeros(2), 5.0)
    np.testing.assert_array_equal(flattener.layers().elevation, flatten(held).elevation)


@pytest.mark.parametrize(("spread", "steep"), [(6.0, 1.0), (6.0, 0.02), (2.0, 0.1)])
@pytest.mark.parametrize("channels", [0, 2])
def test_single_cells_are_read_as_the_layers_have_them(spread, steep, channels):
    held, rng = VoxelMap(channels, SMALL), np.random.default_rng(1)
    one, other = Flattener(held, FlattenSettings()), Flattener(held, FlattenSettings())
    for step in range(3):
        held.recentre(np.array([2.5 * step, -1.0 * step]), 0.3 * step)
        points = rng.uniform(-spread, spread, (600, 3)) * [1, 1, steep] + np.array([2.5 * step, -1.0 * step, 0])
        features = rng.normal(size=(600, channels)).astype(np.float32)
        held.insert(points, features, rng.random(600) < 0.5, rng.uniform(1, 40, 600).astype(np.float32))
        rows, columns = rng.permutation(np.mgrid[: 2 * N, : 2 * N].reshape(2, -1).T).T
        if step != 1:
            one.layers()
        cells, layers = one.cells(rows, columns), other.layers()
        assert layers.known.any()
        assert not layers.known.all()
        assert layers.valid.any()
        for name in cells._fields:
            np.testing.assert_array_equal(getattr(cells, name), getattr(layers, name)[rows, columns], err_msg=name)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_few_cells_are_read_as_the_layers_have_them(count):
    """Of a map that moves in between, so that rows wrap around, and whose layers are made now and then."""
    held, rng = VoxelMap(2, SMALL), np.random.default_rng(count)
    one = Flattener(held, FlattenSettings(overhang_radius=0.6))
    for step in range(40):
        place = np.array([0.7 * step, -0.5 * step, 0.1 * step])
        held.recentre(place[:2], place[2])
        points = rng.uniform(-6, 6, (300, 3)) * [1, 1, 0.3] + place
        features = rng.normal(size=(300, 2)).astype(np.float32)
        held.insert(points, features, rng.random(300) < 0.5, rng.uniform(1, 40, 300).astype(np.float32))
        if step % 7 == 3:
            one.layers()
        layers = flatten(held, one.settings)
        for _ in range(2):
            # Now anywhere, now along a line, as wheels leave them.
            spread = rng.uniform(0, 2 * N, 2)
            rows, columns = (rng.uniform(0, spread[:, None], (2, count)) + (2 * N - spread[:, None])).astype(np.int64)
            cells = one.cells(rows, columns)
            for name in cells._fields:
                np.testing.assert_array_equal(getattr(cells, name), getattr(layers, name)[rows, columns], err_msg=name)


# --- planes ----------------------------------------------------------------------------------------------------------
PLANES = {"z = x": (1.0, 0.0), "z = y": (0.0, 1.0), "z = -x/2 + y/3": (-0.5, 1 / 3)}


@pytest.mark.parametrize("scatter", [0.0, 0.09])
@pytest.mark.parametrize("plane", PLANES)
def test_planes_have_their_normals_and_their_heights_wherever_in_the_cells_they_were_hit(plane, scatter):
    rise = PLANES[plane]
    layers = flatten(ground(*rise, scatter=scatter))
    up = np.array([-rise[0], -rise[1], 1.0]) / np.sqrt(1 + rise[0] ** 2 + rise[1] ** 2)
    np.testing.assert_allclose(layers.normal, np.broadcast_to(up, layers.normal.shape), atol=2e-5)
    x, y = np.meshgrid(layers.origin[0] + 0.2 * np.arange(2 * N), layers.origin[1] + 0.2 * np.arange(2 * N))
    np.testing.assert_allclose(layers.elevation, rise[0] * x + rise[1] * y + 0.03, atol=1e-5)
    np.testing.assert_allclose(layers.slope, np.hypot(*rise), atol=3e-5)
    np.testing.assert_allclose(layers.roughness, 0, atol=2e-5)


@pytest.mark.parametrize("plane", PLANES)
def test_planes_with_gaps_have_the_same_normals(plane):
    rise = PLANES[plane]
    layers = flatten(ground(*rise, scatter=0.09, keep=0.4))
    assert 0.3 < layers.observed.mean() < 0.5
    told = np.isfinite(layers.slope)
    assert told.mean() > 0.95
    np.testing.assert_allclose(layers.normal[told, :2] / -layers.normal[told, 2:], [rise] * told.sum(), atol=3e-4)


@pytest.mark.parametrize("plane", PLANES)
def test_lookups_interpolate_planes(plane):
    rise = PLANES[plane]
    stack = stack_maps([flatten(ground(*rise, scatter=0.05)).terrain_map()])
    place = torch.tensor([[0.0, 0.0], [1.234, -2.345], [-5.9, 5.9]], dtype=torch.float64)
    found = sample_maps(stack, torch.zeros(3, dtype=torch.long), place, torch.zeros(3, 2, dtype=torch.float64))
    up = torch.tensor([-rise[0], -rise[1], 1.0], dtype=torch.float64)
    torch.testing.assert_close(found.normal, (up / up.norm()).expand(3, 3), atol=2e-5, rtol=0)
    assert found.known.all()
    # The feature of a cell is where it was hit in x.
    np.testing.assert_allclose(found.features[:, 0], place[:, 0], atol=0.1501)


def test_bumps_of_a_checkerboard_are_its_roughness():
    """Cells alternately 2 cm up and down: planes stay level but for the odd cell, and 2 cm are left."""
    held = VoxelMap(0, SMALL)
    j, i = np.mgrid[-N:N, -N:N]
    z = 0.1 + np.where((i + j) % 2, 0.02, -0.02)
    put(held, np.column_stack(((i.ravel() + 0.5) * 0.2, (j.ravel() + 0.5) * 0.2, z.ravel())))
    layers = flatten(held)
    inner = (slice(4, -4), slice(4, -4))
    # A window of 25 has 13 of one sign: its mean is 0.02 / 25 off zero, towards the cell itself.
    np.testing.assert_allclose(layers.roughness[inner], 0.02 * 24 / 25, atol=1e-5)
    np.testing.assert_allclose(layers.slope[inner], 0, atol=1e-5)


def test_one_line_of_hits_has_no_normal_but_two_have():
    for rows, told in ((1, False), (2, True)):
        held = VoxelMap(1, SMALL)
        x, y = np.meshgrid(np.arange(-N, N) * 0.2 + 0.1, 0.1 + 0.2 * np.arange(rows))
        put(held, np.column_stack((x.ravel(), y.ravel(), 0.3 * x.ravel())), [1.0])
        layers = flatten(held)
        assert layers.known[N, N]
        assert np.isfinite(layers.normal[N, N]).all() == told
        assert np.isfinite(layers.normal[N - 2, N]).all() == told
        found = sample_maps(
            stack_maps([layers.terrain_map()]),
            torch.tensor([0]),
            torch.tensor([[0.1, 0.15]]),
            torch.zeros(1, 2).double(),
        )
        assert found.known.tolist() == [told]


# --- the grid --------------------------------------------------------------------------------------------------------
@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_a_world_turned_by_90_degrees_gives_the_map_turned(seed):
    """x is nowhere taken for y. Gaps filled from one of two equally near cells would differ, so none are filled."""
    rng = np.random.default_rng(seed)
    points, features = rng.uniform(-6, 6, (3000, 3)) * [1, 1, 0.03], rng.normal(size=(3000, 2))
    one, turned = VoxelMap(2, SMALL), VoxelMap(2, SMALL)
    distance = rng.uniform(1, 40, 3000)
    put(one, points, features, distance)
    put(turned, np.column_stack((-points[:, 1], points[:, 0], points[:, 2])), features, distance)
    flat = FlattenSettings(fill_radius=0.0)
    one, turned = flatten(one, flat), flatten(turned, flat)
    # (x, y) -> (-y, x): the cell in row j, column i goes to row i, column -1 - j.
    for name in ("elevation", "slope", "roughness", "obstacle_height", "distance", "features"):
        layer = np.swapaxes(getattr(one, name), 0, 1)[:, ::-1]
        np.testing.assert_allclose(getattr(turned, name), layer, atol=2e-4, err_msg=name)
    normal = np.swapaxes(one.normal, 0, 1)[:, ::-1]
    np.testing.assert_allclose(turned.normal, normal[..., [1, 0, 2]] * [-1, 1, 1], atol=2e-4)


def test_layers_cover_the_map_and_say_where_they_are():
    held = VoxelMap(0, SMALL)
    held.recentre(np.array([100.0, -50.0]), 3.0)
    layers = flatten(held)
    np.testing.assert_allclose(layers.origin, [94.1, -55.9])
    assert layers.elevation.shape == (60, 60)
    terrain = layers.terrain_map()
    crop = terrain.cropped(np.array([99.0, -51.0]), np.array([101.0, -50.0]))
    assert crop.rise is not None
    assert crop.rise.shape[:2] == crop.elevation.shape


# --- wheels ----------------------------------------------------------------------------------------------------------
def test_a_vehicle_turned_by_90_degrees_reads_what_lies_under_its_own_wheels():
    """Facing +y at (1, 2): front-left is at (0.3, 3.1), rear-right at (1.7, 0.9). z = x: it leans."""
    held = ground(1.0, 0.0)
    under = {(0.3, 3.1): 1.0, (1.7, 3.1): 2.0, (0.3, 0.9): 3.0, (1.7, 0.9): 4.0}
    for (x, y), feature in under.items():
        put(held, [x, y, x + 0.03], [feature], 1.0)
    wheels = torch.tensor([[1.1, 0.7], [1.1, -0.7], [-1.1, 0.7], [-1.1, -0.7]], dtype=torch.float64)
    stack = stack_maps([flatten(held).terrain_map()])
    number, offset = torch.zeros(1, dtype=torch.long), torch.tensor([[1.0, 2.0]], dtype=torch.float64)
    source = MapTerrain(stack, number, offset, wheels, lambda features, valid: features)
    state = torch.tensor([[0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]], dtype=torch.float64)
    found = source.at(0, state)
    assert found.latent[0, :, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    lean = torch.tensor([-(0.5**0.5), 0.0, 0.5**0.5], dtype=torch.float64)
    torch.testing.assert_close(found.normal[0], lean.expand(4, 3), atol=2e-5, rtol=0)
