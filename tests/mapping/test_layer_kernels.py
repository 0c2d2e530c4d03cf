"""Layers by the compiled library against those by NumPy, and the checks of what the library is given."""

import numpy as np
import pytest

from mapping.test_voxel_kernels import assert_same, scan
from offpiste.mapping.ground import find_spans
from offpiste.mapping.terrain_map import empty_layers
from offpiste.mapping.voxel_map import VoxelMap, VoxelSettings
from offpiste.mapping.voxels_to_layers import Flattener, FlattenSettings
from offpiste.native import library


@pytest.mark.parametrize(("channels", "size", "radius"), [(0, 0.2, 0.4), (3, 0.2, 0.2), (2, 0.11, 0.6)])
def test_layers_and_cells_are_the_same_without_the_library(channels, size, radius, monkeypatch):
    """From an empty map on, with rows that wrap around, of widths that are no multiple of a vector's."""
    rng, compiled = np.random.default_rng(channels), library.library
    held = VoxelMap(channels, VoxelSettings(size=size, reach=3.0, height_reach=20.0, capacity=40_000))
    settings = FlattenSettings(plane_radius=radius)
    by_library, by_numpy, layers = Flattener(held, settings), Flattener(held, settings), None
    centre = np.array([1e5, -2e5, 3.0])
    for step in range(6):
        if step:
            centre += rng.normal(0, [1.0, 1.0, 0.3]) * (20 if step == 3 else 1)
            held.recentre(centre[:2], centre[2])
            held.insert(*scan(rng, centre, 1200, channels))
        rows, columns = rng.integers(0, held.cells, (2, 33))
        cells, layers = by_library.cells(rows, columns), by_library.layers(layers)
        monkeypatch.setattr(library, "library", lambda: None)
        some, wanted = by_numpy.cells(rows, columns), by_numpy.layers()
        monkeypatch.setattr(library, "library", compiled)
        assert_same(layers, wanted, 3e-5)
        assert layers.known.any() == (step > 0)
        for name in cells._fields:
            np.testing.assert_array_equal(getattr(cells, name), getattr(layers, name)[rows, columns])
            np.testing.assert_allclose(getattr(some, name), getattr(wanted, name)[rows, columns], atol=1e-6)


def test_layers_of_another_map_and_cells_outside_the_map_are_refused():
    held = VoxelMap(2, VoxelSettings(reach=3.0, capacity=100))
    flattener = Flattener(held, FlattenSettings())
    for cells, channels in ((32, 2), (30, 3), (28, 2)):
        with pytest.raises(ValueError, match="layers of another map"):
            flattener.layers(empty_layers(cells, channels))
    for row, column in ((-1, 0), (0, 30), (30, 0), (0, -1)):
        with pytest.raises(ValueError, match="outside the map"):
            flattener.cells(np.array([3, row]), np.array([3, column]))
    assert not len(flattener.cells(np.zeros(0, np.int64), np.zeros(0, np.int64)).known)


def test_spans_reach_as_far_as_the_margin_and_the_map():
    spans = find_spans(np.array([2, 2, 5]), np.array([4, 7, 0]), 1, 8)
    assert spans.tolist() == [[0, 0], [3, 8], [3, 8], [3, 8], [0, 2], [0, 2], [0, 2], [0, 0]]
