"""Lists of known cells: how far they reach, and lookups that find in them what the whole maps hold."""

import dataclasses

import numpy as np
import pytest
import torch

from offpiste.dataset.map_snapshots import CellList, crop, stack_cells
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.mapping.terrain_sampler import sample_maps, stack_maps


def test_a_snapshot_reaches_as_far_as_five_seconds_and_a_margin():
    flat = TerrainMap(np.zeros(2) - 60, 0.25, np.zeros((481, 481), np.float32), np.zeros((481, 481, 1)), None)
    flat = dataclasses.replace(flat, rise=np.zeros((481, 481, 2), np.float32))
    for yaw, speed in ((0.0, 4.0), (np.pi / 2, 4.0), (1.0, 0.0), (2.0, -0.1), (3.0, -4.0)):
        ahead = (-1 if speed < -1 else 1) * np.array([np.cos(yaw), np.sin(yaw)])
        cells = crop(flat, np.array([1.0, 2.0, yaw, speed, 0.0, 0.0]))  # a disc of 10 + 18 m, 10 m ahead
        row, column = np.divmod(cells.place, cells.shape[1])
        places = cells.origin + 0.25 * np.stack((column, row), axis=-1)
        along = (places - [1.0, 2.0]) @ ahead
        assert along.max() == pytest.approx(38.0, abs=0.13)
        assert along.min() == pytest.approx(-18.0, abs=0.13)
        assert len(places) == pytest.approx(np.pi * 28**2 / 0.25**2, rel=0.01)


def holed(rng: np.random.Generator, shape: tuple[int, int]) -> tuple[TerrainMap, CellList]:
    """A map with random holes, and the list of its cells."""
    known = rng.random(shape) < 0.9
    flat = np.where(known, 0.0, np.nan).astype(np.float32)
    features = np.where(known[..., None] & (rng.random(shape) < 0.8)[..., None], rng.normal(size=(*shape, 3)), np.nan)
    rise = np.where(known[..., None], rng.normal(size=(*shape, 2)), np.nan).astype(np.float16)
    origin = rng.uniform(-20, 20, 2)
    row, column = np.nonzero(known)
    place = (row * shape[1] + column).astype(np.int32)
    features = features.astype(np.float16)
    cells = CellList(origin, shape, place, flat[known], rise[known], features[known])
    return TerrainMap(origin, 0.25, flat, features, rise), cells


def test_lists_of_cells_are_read_as_the_maps_they_are_lists_of():
    rng = np.random.default_rng(0)
    maps, cells = zip(*(holed(rng, shape) for shape in ((30, 50), (60, 20), (5, 7))), strict=True)
    dense, listed = stack_maps(maps), stack_cells(cells, 0.25)
    assert dense.shape == listed.place.shape[1:] == (60, 50)
    number = torch.as_tensor(rng.integers(3, size=4000))
    place = torch.as_tensor(np.stack([m.origin for m in maps])[number] + rng.uniform(-2, 16, (4000, 2)))
    one, other = (sample_maps(stack, number, place, torch.zeros_like(place)) for stack in (dense, listed))
    assert 100 < one.known.sum() < one.valid.sum() < 2000
    for name in ("normal", "known", "features", "valid"):
        torch.testing.assert_close(getattr(other, name), getattr(one, name), rtol=0, atol=0, equal_nan=True)


def test_cells_near_a_path_are_those_within_the_margin():
    rng = np.random.default_rng(1)
    terrain, cells = holed(rng, (80, 120))
    path = terrain.origin + np.array([[5.0, 5.0], [8.0, 9.0], [11.0, 10.0]])
    near = cells.near(path, 3.0, 0.25)
    assert near.shape[0] < 60
    found, wanted = near.terrain_map(0.25), terrain
    shift = np.round((found.origin - wanted.origin) / 0.25).astype(int)
    row, column = np.mgrid[:80, :120]
    centres = terrain.origin + 0.25 * np.stack((column, row), axis=-1)
    within = np.hypot(*(centres[:, :, None] - path).transpose(3, 0, 1, 2)).min(axis=-1) <= 3.0
    expected = np.where(within[..., None], wanted.features, np.nan)
    there = np.full_like(expected, np.nan)
    ny, nx = found.elevation.shape
    there[shift[1] : shift[1] + ny, shift[0] : shift[0] + nx] = found.features
    np.testing.assert_array_equal(there, expected)
    assert len(near.place) == (within & np.isfinite(wanted.elevation)).sum()
    nowhere = cells.near(path + 1000.0, 3.0, 0.25)
    assert nowhere.shape == (1, 1)
    assert not len(nowhere.place)
