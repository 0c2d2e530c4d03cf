"""What a rolling map leaves behind, on maps of a few cells."""

from dataclasses import replace

import numpy as np

from offpiste.mapping.terrain_map import TerrainLayers, empty_layers
from offpiste.visualization.map_figure import FEATURED, FILLED, OBSERVED, UNKNOWN, Mosaic

SIZE = 0.2


def layers_at(low: tuple[int, int], cells: int = 4, channels: int = 2) -> TerrainLayers:
    """A map whose lowest cell is `low`; every cell observed, its elevation 100 x + y of its whole coordinates."""
    layers = empty_layers(cells, channels)
    y, x = np.mgrid[low[1] : low[1] + cells, low[0] : low[0] + cells]
    layers.elevation[:] = 100 * x + y
    layers.obstacle_height[:] = 0.5
    layers.slope[:] = 0.1
    layers.known[:] = layers.observed[:] = True
    return replace(layers, origin=(np.array(low) + 0.5) * SIZE, resolution=SIZE)


def test_cells_stay_where_they_are_in_the_world() -> None:
    mosaic = Mosaic(np.array([-1.0, -1.0]), np.array([3.0, 3.0]), SIZE)
    assert mosaic.step == 1
    for low in ((0, 0), (3, -2), (-4, 7)):
        mosaic.add(layers_at(low))
    ground = mosaic.ground
    rows, columns = np.nonzero(ground.known)
    place = ground.origin + np.column_stack((columns, rows)) * SIZE
    x, y = np.floor(place / SIZE + 1e-6).T
    np.testing.assert_array_equal(ground.elevation[rows, columns], 100 * x + y)
    assert len(rows) == 3 * 16 - 1 * 2  # columns 3 of the first two maps share rows 0 and 1


def test_what_a_later_map_does_not_know_stays_and_what_it_knows_is_taken() -> None:
    mosaic = Mosaic(np.zeros(2), np.ones(2), SIZE)
    mosaic.add(layers_at((0, 0)))
    later = layers_at((0, 0))
    later.known[:, 0] = False
    later.elevation[:, 1] = -7.0
    later.observed[2, 1] = False
    later.valid[3, 1] = True
    later.features[3, 1] = 0.25, 0.5
    mosaic.add(later)
    np.testing.assert_allclose(mosaic.ground.cropped(np.array([0.25, 0.05]), np.array([0.55, 0.35])).origin, (0.3, 0.1))
    ground = mosaic.ground.trimmed()
    np.testing.assert_array_equal(ground.elevation[:, 0], [0, 1, 2, 3])
    np.testing.assert_array_equal(ground.elevation[:, 1], -7)
    np.testing.assert_array_equal(ground.known[:, 1], [OBSERVED, OBSERVED, FILLED, FEATURED])
    np.testing.assert_array_equal(ground.components[3, 1], (0.25, 0.5, 0))
    assert np.isnan(ground.components[0, 1]).sum() >= 2


def test_a_long_drive_takes_every_nth_cell_whatever_the_maps_place() -> None:
    mosaic = Mosaic(np.zeros(2), np.full(2, 10.0), SIZE, most=400)
    assert mosaic.step == 3
    for low in ((0, 0), (1, 2), (5, 4), (20, 19)):
        mosaic.add(layers_at(low))
    ground = mosaic.ground
    assert ground.known.size <= 20 * 20
    rows, columns = np.nonzero(ground.known)
    place = ground.origin + np.column_stack((columns, rows)) * ground.resolution
    x, y = np.floor(place / SIZE + 1e-6).astype(int).T
    assert set(zip(x % 3, y % 3, strict=True)) == {(0, 0)}
    np.testing.assert_array_equal(ground.elevation[rows, columns], 100 * x + y)


def test_maps_without_features_or_off_the_mosaic() -> None:
    mosaic = Mosaic(np.zeros(2), np.ones(2), SIZE)
    mosaic.add(layers_at((2, 2), channels=0))
    mosaic.add(layers_at((1000, -1000)))
    ground = mosaic.ground.trimmed()
    assert ground.known.shape == (4, 4)
    assert np.isnan(ground.components).all()
    assert Mosaic(np.zeros(2), np.ones(2), SIZE).ground.trimmed().known.max() == UNKNOWN
