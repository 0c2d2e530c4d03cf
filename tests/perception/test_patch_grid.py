"""Where patches lie: the paper's numbers, hand-worked answers, and projection through the feature image's K."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offpiste.core.errors import PerceptionError
from offpiste.perception.patch_grid import PatchGrid


def camera_matrix(grid: PatchGrid, matrix: np.ndarray) -> np.ndarray:
    """K of the feature image, whose pixels are the patches, for an image of this K: a reference for `cells`."""
    x, y = grid.offset
    shift = np.array([[1.0, 0.0, 0.5 - x], [0.0, 1.0, 0.5 - y], [0.0, 0.0, 1.0]])
    middle = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    return middle @ np.diag([1 / grid.size, 1 / grid.size, 1.0]) @ shift @ matrix


def test_the_papers_image_has_68x42_patches_of_a_centred_crop():
    grid = PatchGrid(960, 594, 14)
    assert (grid.columns, grid.rows) == (68, 42)
    assert grid.offset == (4, 3)
    assert grid.crop == (slice(3, 591), slice(4, 956))


def test_odd_remainders_leave_the_larger_edge_right_and_below():
    grid = PatchGrid(33, 31, 14)  # 5 columns and 3 rows are left over
    assert grid.offset == (2, 1)


@given(width=st.integers(14, 200), height=st.integers(14, 200), size=st.integers(1, 14))
def test_the_crop_is_whole_patches_inside_the_image(width: int, height: int, size: int):
    grid = PatchGrid(width, height, size)
    rows, columns = grid.crop
    assert 0 <= rows.start <= rows.stop <= height
    assert rows.stop - rows.start == grid.rows * size > height - size
    assert 0 <= columns.start <= columns.stop <= width
    assert columns.stop - columns.start == grid.columns * size > width - size


def test_cells_at_the_borders_of_the_first_and_the_last_patch():
    grid = PatchGrid(960, 594, 14)
    pixels = np.array([[3.5, 2.5], [3.49, 2.5], [17.49, 16.49], [17.5, 16.5], [955.49, 590.49], [955.5, 590.49]])
    row, column, inside = grid.cells(pixels)
    assert inside.tolist() == [True, False, True, True, True, False]
    assert row[inside].tolist() == [0, 0, 1, 41]
    assert column[inside].tolist() == [0, 0, 1, 67]


def test_places_that_are_nowhere_are_outside():
    grid = PatchGrid(28, 28, 14)
    row, column, inside = grid.cells(np.array([[np.nan, 3.0], [np.inf, 3.0], [-1e30, 1e30]]))
    assert not inside.any()
    assert (row == 0).all()
    assert (column == 0).all()


def test_the_feature_cameras_k_leads_to_the_same_patch_as_the_images():
    grid = PatchGrid(960, 594, 14)
    matrix = np.array([[530.0, 0.0, 483.2], [0.0, 530.5, 294.6], [0.0, 0.0, 1.0]])
    points = np.random.default_rng(0).uniform((-4, -2, 4), (4, 2, 9), size=(500, 3))

    def project(k: np.ndarray) -> np.ndarray:
        homogeneous = points @ k.T
        return homogeneous[:, :2] / homogeneous[:, 2:]

    row, column, inside = grid.cells(project(matrix))
    in_patches = np.rint(project(camera_matrix(grid, matrix))).astype(int)
    assert inside.sum() > 300
    assert (in_patches[inside] == np.column_stack((column, row))[inside]).all()


def test_the_middle_of_the_first_patch_is_the_feature_images_origin():
    grid = PatchGrid(960, 594, 14)
    # The crop starts at pixel (4, 3): the middle of its first 14x14 pixels lies at (10.5, 9.5).
    assert np.allclose(camera_matrix(grid, np.eye(3)) @ [10.5, 9.5, 1.0], [0.0, 0.0, 1.0])


def test_hit_marks_the_patches_of_points():
    grid = PatchGrid(42, 28, 14)
    hit = grid.hit(np.array([[20.0, 3.0], [21.0, 3.0], [40.0, 20.0], [-5.0, 3.0]]))
    assert hit.tolist() == [[False, True, False], [False, False, True]]


def test_share_of_a_mask():
    grid = PatchGrid(30, 16, 14)  # the crop starts at (1, 1)
    mask = np.zeros((16, 30), dtype=bool)
    mask[1:8, 1:15] = True  # the upper half of the first patch
    mask[0, :] = True  # cropped away
    assert grid.share(mask).tolist() == [[0.5, 0.0]]


def test_an_image_smaller_than_a_patch_is_refused():
    with pytest.raises(PerceptionError, match=r"^an image of 13x100 holds no patch of 14x14 pixels"):
        PatchGrid(13, 100, 14)
