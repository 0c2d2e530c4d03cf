"""Boxes of a map, by hand."""

import numpy as np

from planning_maps import layers


def test_a_box_is_cut_out_to_whole_cells() -> None:
    whole = layers(plane=(0.1, -0.3))  # cells every 0.5 m from -20 to 20 m
    near = whole.cropped(np.array((1.2, -3.1)), np.array((5.2, 0.9)))
    np.testing.assert_allclose(near.origin, (1.0, -3.5))
    assert near.known.shape == (10, 10)  # to 5.5 and 1.0 m
    np.testing.assert_allclose(near.elevation, 0.1 * near.centres[..., 0] - 0.3 * near.centres[..., 1], atol=1e-6)
    assert np.shares_memory(near.elevation, whole.elevation)
    sampled = whole.terrain_map().cropped(np.array((1.2, -3.1)), np.array((5.2, 0.9)))
    np.testing.assert_array_equal(sampled.elevation, near.elevation)
    np.testing.assert_array_equal(sampled.origin, near.origin)


def test_a_box_over_the_border_ends_there_and_one_beside_the_map_leaves_a_cell_of_it() -> None:
    whole = layers(plane=(0.1, -0.3))
    assert whole.cropped(np.array((17.0, -21.0)), np.array((21.0, -17.0))).known.shape == (7, 7)
    assert whole.cropped(np.array((498.0, -2.0)), np.array((502.0, 2.0))).known.shape == (9, 1)
