"""Patches of an image: the paper's numbers, and whole patches in the centre."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offpiste.core.errors import PerceptionError
from offpiste.perception.patch_grid import PatchGrid


def test_the_papers_image_has_68x42_patches_of_a_centred_crop():
    grid = PatchGrid(960, 594, 14)
    assert (grid.columns, grid.rows) == (68, 42)
    assert grid.offset == (4, 3)
    assert grid.crop == (slice(3, 591), slice(4, 956))


@given(width=st.integers(14, 200), height=st.integers(14, 200), size=st.integers(1, 14))
def test_the_crop_is_whole_patches_in_the_centre(width: int, height: int, size: int):
    grid = PatchGrid(width, height, size)
    for crop, length, count in zip(grid.crop, (height, width), (grid.rows, grid.columns), strict=True):
        assert 0 <= crop.start <= length - crop.stop <= crop.start + 1
        assert crop.stop - crop.start == count * size > length - size


def test_share_of_a_mask():
    grid = PatchGrid(30, 16, 14)  # the crop starts at (1, 1)
    mask = np.zeros((16, 30), dtype=bool)
    mask[1:8, 1:15] = True  # the upper half of the first patch
    mask[0, :] = True  # cropped away
    assert grid.share(mask).tolist() == [[0.5, 0.0]]


def test_an_image_smaller_than_a_patch_is_refused():
    with pytest.raises(PerceptionError, match=r"^an image of 13x100 pixels is smaller than a patch \(14x14\)"):
        PatchGrid(13, 100, 14)
