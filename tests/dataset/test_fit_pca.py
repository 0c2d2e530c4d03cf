"""Lists of images for a PCA."""

import numpy as np
import pytest

from offpiste.core.errors import PerceptionError
from offpiste.dataset import fit_pca
from offpiste.dataset.fit_pca import ListedImage, read_image_list, write_image_list


def test_a_list_comes_back_with_names_that_have_blanks(tmp_path):
    images = [ListedImage("my drive", "front", 12.25), ListedImage("b", "rear", 1700000000.123456)]
    write_image_list(tmp_path / "list.txt", images)
    (tmp_path / "list.txt").write_text("# chosen by hand\n\n" + (tmp_path / "list.txt").read_text())
    assert read_image_list(tmp_path / "list.txt") == images


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a front\n", "line 1: 'a front' is not an image"),
        ("a f x\n", "line 1"),
        ("#\n", "lists no image"),
        (None, "cannot read the list of images"),
    ],
)
def test_what_is_no_list_ends_in_one_line(tmp_path, text, said):
    if text is not None:
        (tmp_path / "list.txt").write_text(text)
    with pytest.raises(PerceptionError, match=said):
        read_image_list(tmp_path / "list.txt")


def test_a_stamp_is_rounded_alike_from_an_array_and_from_an_image():
    stamps = 1_700_000_000 + np.random.default_rng(0).integers(0, 10**11, 500) * 1e-9
    assert any(round(stamp, 6) != rounded for stamp, rounded in zip(stamps.tolist(), np.round(stamps, 6), strict=True))
    assert [fit_pca._moment(stamp) for stamp in stamps] == [round(stamp, 6) for stamp in stamps.tolist()]
