"""Ground of windows: the right cells, turned to the heading, from the map as it was at the start."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feature_datasets import dataset_with_features, with_snapshots
from offpiste.dataset.store import Dataset
from offpiste.evaluation.ground_pictures import GREY, PIXELS, GroundPicture, ground_pictures
from offpiste.mapping.terrain_map import TerrainMap

SQUARE = ((8.0, 0.0), 10.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("data") / "small.zarr", ("train", "test"), rows=600)


def pictures(dataset: Dataset, row: int, yaw: float = 0.0, square=SQUARE) -> list[GroundPicture | None]:
    return ground_pictures(dataset, np.array([1]), np.array([row]), np.array([[0.0, 0.0, yaw]]), [square])


def quadrants(dataset: Dataset) -> Dataset:
    """Features that grow towards +x (first) and +y (second); without them where y > 5; nothing where x > 15."""
    drive = dataset.drives[1]
    x, y = np.meshgrid(np.arange(-30, 31.0), np.arange(-30, 31.0))
    features = np.stack((x, y, np.zeros_like(x)), axis=-1)
    features[y > 5] = np.nan
    features[x > 15] = np.nan
    elevation = np.where(x > 15, np.nan, 0.0)
    terrain = TerrainMap(drive.rows.origin - 30.0, 1.0, elevation, features)
    return replace(dataset, drives=(dataset.drives[0], replace(drive, load_map=lambda: terrain)))


def test_ahead_is_up_and_left_is_left(dataset: Dataset) -> None:
    (picture,) = pictures(quadrants(dataset), 100)
    assert picture is not None
    rgba, middle = picture.rgba.astype(int), PIXELS // 2
    assert not picture.at_start
    assert rgba[0, middle, 3] == 0, "18 m ahead, x > 15, nothing is known"
    assert rgba[middle, 0].tolist() == [GREY, GREY, GREY, 255], "10 m to the left, y > 5, no camera has seen the ground"
    assert rgba[middle, -1, 3] == 255
    assert rgba[-10, middle, 0] < rgba[40, middle, 0], "the first feature grows ahead"
    assert rgba[middle, -10, 1] < rgba[middle, middle, 1], "the second grows to the left"


def test_the_picture_turns_with_the_heading(dataset: Dataset) -> None:
    around = ((0.0, 0.0), 10.0)
    (straight,), (turned,) = (pictures(quadrants(dataset), 100, yaw, around) for yaw in (0.0, np.pi / 2))
    assert straight is not None
    assert turned is not None
    # What lay to the left lies ahead.
    same = np.rot90(straight.rgba, -1) == turned.rgba
    assert same.all(axis=-1).mean() > 0.95, "but for pixels on the edges of cells"


def test_the_map_at_the_start_comes_before_that_of_the_drive(dataset: Dataset, tmp_path: Path) -> None:
    snapped = with_snapshots(dataset, tmp_path, [100])
    (at_start,), (later,) = pictures(snapped, 100), pictures(snapped, 101)
    assert at_start is not None
    assert later is not None
    assert (at_start.at_start, later.at_start) == (True, False)


def test_without_features_or_maps_there_is_no_ground(dataset: Dataset) -> None:
    assert pictures(replace(dataset, features=()), 100) == [None]
    drives = tuple(replace(drive, load_map=None) for drive in dataset.drives)
    assert pictures(replace(dataset, drives=drives), 100) == [None]
