"""The vehicle's own body in images and clouds."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from offpiste.core.errors import PerceptionError
from offpiste.perception.masks import free_patches, mask_from_png, mask_from_polygons
from offpiste.perception.patch_grid import PatchGrid


def test_a_painted_mask(tmp_path: Path):
    painted = np.zeros((20, 30, 3), dtype=np.uint8)
    painted[15:, 5:25, 0] = 200
    cv2.imwrite(str(tmp_path / "bonnet.png"), painted)
    mask = mask_from_png(tmp_path / "bonnet.png", 30, 20)
    assert mask.sum() == 5 * 20
    assert mask[15, 5]
    with pytest.raises(PerceptionError, match=r"bonnet.png: a mask of 30x20 for a camera of 20x30"):
        mask_from_png(tmp_path / "bonnet.png", 20, 30)


@pytest.mark.parametrize("content", [None, b"", b"no picture"])
def test_no_painted_mask(tmp_path: Path, content: bytes | None):
    if content is not None:
        (tmp_path / "x.png").write_bytes(content)
    with pytest.raises(PerceptionError, match=r"x.png: no picture to mask a camera with"):
        mask_from_png(tmp_path / "x.png", 30, 20)


def test_polygons_overlap_without_cancelling_and_may_leave_the_image():
    square = [(2.0, 2.0), (9.0, 2.0), (9.0, 9.0), (2.0, 9.0)]
    shifted = [(x + 4, y) for x, y in square]
    mask = mask_from_polygons([square, shifted], 20, 12)
    assert mask.sum() == 8 * 12
    assert mask[2:10, 2:14].all()
    below = mask_from_polygons([[(-50.0, 8.0), (70.0, 8.0), (70.0, 99.0), (-50.0, 99.0)]], 20, 12)
    assert below[8:].all()
    assert not below[:8].any()
    assert not mask_from_polygons([], 20, 12).any()


def test_a_polygon_of_two_corners():
    with pytest.raises(PerceptionError, match="polygon of 2 corners"):
        mask_from_polygons([[(0.0, 0.0), (1.0, 1.0)]], 20, 12)


def test_patches_with_a_little_of_the_body_may_stay():
    grid = PatchGrid(30, 10, 10)
    own = np.zeros((10, 30), dtype=bool)
    own[9, 10:20] = True  # a tenth of the second patch
    own[8:, 20:] = True  # a fifth of the third
    assert free_patches(own, grid).tolist() == [[True, True, False]]
