"""Sampling of maps: planes, borders, holes, several maps, crops."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from factories import tilted_map
from offpiste.mapping.terrain_map import TerrainMap, wheel_positions
from offpiste.mapping.terrain_sampler import MapTerrain, sample_maps, stack_maps
from planning_maps import layers

WHEELS = np.array([[1.0, 0.7], [1.0, -0.7], [-1.2, 0.6], [-1.2, -0.6]])


def plane(rise_x: float, rise_y: float, *, shape=(30, 50), origin=(10.0, -20.0), resolution=0.5) -> TerrainMap:
    return tilted_map((rise_x, rise_y), shape, origin, resolution)


def found_at(maps, places, number=0):
    place = torch.as_tensor(places, dtype=torch.float64)
    numbers = torch.full(place.shape[:-1], number)
    return sample_maps(stack_maps(maps), numbers, place, torch.zeros_like(place))


def test_a_plane_has_its_normal_everywhere_and_x_is_not_y():
    found = found_at([plane(0.3, -0.1)], [[10.2, -19.9], [20.0, -10.0], [34.4, -5.6]])
    wanted = torch.tensor([-0.3, 0.1, 1.0], dtype=torch.float64)
    torch.testing.assert_close(found.normal, (wanted / wanted.norm()).expand(3, 3), atol=1e-6, rtol=0)
    assert found.known.all()
    found = found_at([plane(0, 0)], [[10.0 + 0.5 * 7 + 0.2, -20.0 + 0.5 * 3 - 0.2]])
    assert found.features.tolist() == [[7.0, 3.0]]  # those of the nearest cell


def test_normals_between_cells_are_bilinear():
    terrain = plane(0, 0, shape=(5, 6), origin=(0.0, 0.0), resolution=1.0)
    y, x = np.mgrid[:5, :6].astype(float)
    terrain = TerrainMap(terrain.origin, 1.0, 0.5 * x * x + x * y, terrain.features)
    # Central differences of a quadratic are exact inside: rise_x = x + y, rise_y = x.
    found = found_at([terrain], [[2.25, 1.75]])
    slope = -found.normal[0, :2] / found.normal[0, 2]
    torch.testing.assert_close(slope, torch.tensor([4.0, 2.25], dtype=torch.float64), atol=1e-6, rtol=0)


@settings(deadline=None)
@given(st.floats(-100, 100), st.floats(-100, 100))
def test_off_the_map_is_flat_and_missing(x, y):
    terrain = plane(0.3, -0.1)
    found = found_at([terrain], [[x, y]])
    inside = 9.75 < x < 10 + 0.5 * 49 + 0.25 and -20.25 < y < -20 + 0.5 * 29 + 0.25
    assert bool(found.valid[0]) == bool(found.known[0]) == inside
    if not inside:
        assert found.normal.tolist() == [[0.0, 0.0, 1.0]]
    invalid = found_at([terrain], [[np.nan, 0.0], [np.inf, -15.0], [20.0, -np.inf]])
    assert not (invalid.valid | invalid.known).any()


def test_a_map_in_a_stack_is_read_as_alone():
    rng = np.random.default_rng(0)
    shapes = ((30, 50), (60, 20), (5, 7), (1, 9), (6, 1))
    maps = []
    for shape in shapes:
        terrain = plane(0, 0, shape=shape, origin=tuple(rng.uniform(-5, 5, 2)))
        rise = np.where(rng.random((*shape, 1)) < 0.9, rng.normal(size=(*shape, 2)), np.nan)
        maps.append(replace(terrain, rise=rise.astype(np.float32)))
    for number, terrain in enumerate(maps):
        cells = np.array(shapes[number])[::-1]
        places = terrain.origin + 0.5 * rng.uniform(-1.5, cells + 0.5, (500, 2))  # also just outside
        places[::5, 0] = terrain.origin[0] + 0.5 * (cells[0] - 1)  # on the last column
        alone, stacked = found_at([terrain], places), found_at(maps, places, number)
        assert 0 < alone.known.sum() < len(places)
        for name in ("normal", "known", "features", "valid"):
            one, other = getattr(alone, name), getattr(stacked, name)
            if name == "features":  # off the map they are of any cell
                one, other = one[alone.valid], other[stacked.valid]
            torch.testing.assert_close(other, one, rtol=0, atol=0, equal_nan=True)
    with pytest.raises(ValueError, match="one resolution"):
        stack_maps([maps[0], plane(0, 0, resolution=1.0)])


def test_a_crop_says_the_same_as_the_whole():
    whole = plane(0.3, -0.1)
    part = whole.cropped(np.array([15.0, -15.0]), np.array([20.2, -9.9]))
    assert part.elevation.size < whole.elevation.size / 4
    places = np.random.default_rng(0).uniform([15.0, -15.0], [20.2, -9.9], (50, 2))
    one, other = found_at([whole], places), found_at([part], places)
    torch.testing.assert_close(one.features, other.features)
    torch.testing.assert_close(one.normal, other.normal)
    layered = layers(plane=(0.1, -0.3))  # cells every 0.5 m from -20 to 20 m
    near = layered.cropped(np.array((1.2, -3.1)), np.array((5.2, 0.9)))  # to 5.5 and 1.0 m
    np.testing.assert_allclose(near.origin, (1.0, -3.5))
    assert near.known.shape == (10, 10)
    np.testing.assert_allclose(near.elevation, near.centres @ (0.1, -0.3), atol=1e-6)
    assert np.shares_memory(near.elevation, layered.elevation)
    assert layered.cropped(np.array((17.0, -21.0)), np.array((21.0, -17.0))).known.shape == (7, 7)  # over the border
    assert layered.cropped(np.array((498.0, -2.0)), np.array((502.0, 2.0))).known.shape == (9, 1)  # off the map


def test_wheels_of_the_predicted_state_are_looked_up():
    rng = np.random.default_rng(0)
    terrain = plane(0.3, -0.1, shape=(200, 300))
    offset = rng.uniform([60.0, 10.0], [80.0, 30.0], (8, 2))
    state = torch.as_tensor(np.column_stack((rng.normal(0, 5, (8, 2)), rng.uniform(-4, 4, 8), rng.normal(size=(8, 3)))))
    source = MapTerrain(
        stack_maps([terrain]),
        torch.zeros(8, dtype=torch.long),
        torch.as_tensor(offset),
        torch.as_tensor(WHEELS),
        lambda features, valid: features.double(),
    )
    ground = source.at(3, state)
    places = wheel_positions(state[:, :2].numpy() + offset, state[:, 2].numpy(), WHEELS)
    wanted = np.round((places - terrain.origin) / terrain.resolution)
    np.testing.assert_array_equal(ground.latent, wanted)
    assert ground.normal.shape == (8, 4, 3)

    places = wheel_positions(np.array([[3.0, 4.0]]), np.array([np.pi / 2]), WHEELS)
    np.testing.assert_allclose(places[0], [[2.3, 5.0], [3.7, 5.0], [2.4, 2.8], [3.6, 2.8]])
