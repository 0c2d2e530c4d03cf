"""Ground as triangles and tiles."""

from dataclasses import replace

import numpy as np

from offpiste.mapping.terrain_map import empty_layers
from offpiste.visualization.rerun_recording import TILE, grid_triangles, tiles


def test_a_square_of_four_known_cells_gives_two_triangles_that_look_up() -> None:
    found = grid_triangles(np.ones((2, 2), bool))
    np.testing.assert_array_equal(found, [[0, 1, 3], [0, 3, 2]])
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    for a, b, c in corner[found]:
        assert np.cross(b - a, c - a)[2] > 0


def test_squares_with_an_unknown_corner_are_left_out_and_numbers_count_known_cells() -> None:
    known = np.array([[False, True, True], [True, True, True]])
    np.testing.assert_array_equal(grid_triangles(known), [[0, 1, 4], [0, 4, 3]])
    assert grid_triangles(np.zeros((3, 3), bool)).shape == (0, 3)
    assert grid_triangles(np.ones((1, 5), bool)).shape == (0, 3)


def test_tiles_cover_every_cell_and_take_the_same_ones_wherever_the_map_is() -> None:
    for low in ((-130, 70), (0, 0), (-7, 251)):
        layers = replace(empty_layers(150, 0), origin=(np.array(low) + 0.5) * 0.2, resolution=0.2)
        taken = np.zeros((150, 150), int)
        for tile in tiles(layers, 2):
            taken[tile.cells] += 1
            x, y = np.floor(layers.centres[tile.cells] / 0.2 + 1e-6).astype(int).reshape(-1, 2).T
            assert set(x % 2) == set(y % 2) == {0}
            for axis, cells in enumerate((x, y)):
                assert cells.min() >= tile.place[axis] * TILE
                assert cells.max() <= (tile.place[axis] + 1) * TILE
        every = np.zeros((150, 150), bool)
        every[-low[1] % 2 :: 2, -low[0] % 2 :: 2] = True
        np.testing.assert_array_equal(taken > 0, every)
        assert taken.max() <= 4  # where tiles meet
