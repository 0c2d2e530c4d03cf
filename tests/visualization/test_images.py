"""Components as colours."""

from pathlib import Path

import cv2
import numpy as np

from offpiste.perception.patch_grid import PatchGrid
from offpiste.report.feature_colours import colour_limits, colours
from offpiste.visualization.images import beside, sheet, write_png


def test_percentiles_span_the_colours():
    values = np.linspace(0.0, 100.0, 101)
    components = np.stack((values, -values, np.zeros(101), values), axis=1).reshape(1, 101, 4)
    picture = colours(components)
    assert picture[0, :3, 0].tolist() == [0, 0, 0]  # 2 % are darkest
    assert picture[0, 50].tolist() == [128, 128, 128]  # a constant component is grey
    assert picture[0, 98:, 0].tolist() == [255, 255, 255]
    assert picture[0, 100, 1] == 0


def test_one_outlier_does_not_turn_the_rest_dark():
    components = np.random.default_rng(0).normal(size=(30, 30, 3))
    plain = colours(components)
    components[0, 0] = 1e6
    assert np.abs(colours(components).astype(int) - plain)[1:].mean() < 2


def test_limits_by_mask_and_without_nan():
    components = np.zeros((2, 10, 3))
    components[0] = np.linspace(0, 1, 10)[:, None]
    components[1] = 99.0
    components[0, 4] = np.nan
    mask = np.zeros((2, 10), dtype=bool)
    mask[0] = True
    limits = colour_limits(components, mask)
    assert (limits[1] <= 1.0).all()
    picture = colours(components, limits)
    assert picture[0, 4].tolist() == [0, 0, 0]
    assert picture[1, 0].tolist() == [255, 255, 255]


def test_two_components_and_none_known():
    assert colours(np.full((2, 2, 2), np.nan)).max() == 0
    picture = colours(np.arange(8.0).reshape(2, 2, 2))
    assert (picture[..., 2] == 128).all()


def test_patches_lie_beside_the_image_in_their_places():
    image = np.full((30, 33, 3), 7, dtype=np.uint8)
    grid = PatchGrid(33, 30, 14)  # offset (2, 1)
    patches = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    picture = beside(image, patches, grid)
    assert picture.shape == (30, 66, 3)
    assert (picture[:, :33] == 7).all()
    assert (picture[1:15, 35:49] == [0, 1, 2]).all()
    assert (picture[15:29, 49:63] == [9, 10, 11]).all()
    assert (picture[0, 33:] == 0).all()


def test_a_sheet_is_filled_up_with_black(tmp_path: Path):
    pictures = [np.full((4, 6, 3), value, dtype=np.uint8) for value in (10, 20, 30)]
    whole = sheet(pictures, columns=2)
    assert whole.shape == (8, 12, 3)
    assert whole[0, 6].tolist() == [20, 20, 20]
    assert whole[4:, 6:].max() == 0
    whole[0, 0] = [255, 0, 0]
    write_png(tmp_path / "sheet.png", whole)
    assert cv2.imread(str(tmp_path / "sheet.png"))[0, 0].tolist() == [0, 0, 255]
