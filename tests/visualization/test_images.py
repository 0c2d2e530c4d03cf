"""Features as colours, and pictures of camera images."""

from pathlib import Path

import cv2
import numpy as np

from offpiste.perception.patch_grid import PatchGrid
from offpiste.report.feature_colours import colour_limits, colours
from offpiste.visualization.images import beside, contact_sheet, times_between, write_image


def test_percentiles_span_the_colours_of_known_patches():
    values = np.linspace(0.0, 100.0, 101)
    components = np.stack((values, -values, np.zeros(101), values), axis=1).reshape(1, 101, 4)
    picture = colours(components, colour_limits(components))
    assert picture[0, :3, 0].tolist() == [0, 0, 0]  # 2 % are darkest
    assert picture[0, 50].tolist() == [128, 128, 128]  # a constant component is grey
    assert picture[0, 98:, 0].tolist() == [255, 255, 255]
    assert picture[0, 100, 1] == 0
    components[0, 60] = np.nan
    assert colours(components, colour_limits(components))[0, 60].tolist() == [0, 0, 0]
    nothing, two = np.full((2, 2, 2), np.nan), np.arange(8.0).reshape(2, 2, 2)
    assert colours(nothing, colour_limits(nothing)).max() == 0
    assert (colours(two, colour_limits(two))[..., 2] == 128).all(), "a missing component is grey"


def test_moments_lie_in_the_middle_of_equal_pieces() -> None:
    assert times_between(10.0, 18.0) == (11.0, 13.0, 15.0, 17.0)


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


def test_a_sheet_scales_to_one_width_pads_to_one_height_and_fills_up_with_black(tmp_path: Path) -> None:
    wide, tall = np.full((100, 400, 3), 200, np.uint8), np.full((50, 50, 3), 100, np.uint8)
    sheet = contact_sheet([wide, tall, wide], 2)
    assert sheet.shape == (2000, 2000, 3)
    assert (sheet[:250, :1000] == 200).all()
    assert (sheet[250:1000, :1000] == 0).all()
    assert (sheet[:1000, 1000:] == 100).all()
    assert (sheet[1000:, 1000:] == 0).all()
    sheet[0, 0] = [255, 0, 0]
    write_image(tmp_path / "sheet.png", sheet)
    assert cv2.imread(str(tmp_path / "sheet.png"))[0, 0].tolist() == [0, 0, 255]
