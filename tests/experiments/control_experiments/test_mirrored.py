"""Mirrored drives: the physics drives them as the mirror image of what it drives otherwise."""

import numpy as np
import pytest
import torch

from experiments.control_experiments.mirrored import MIRRORED_STATE, with_mirrored
from feature_datasets import PARTS, dataset_with_features
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.training.build import build, vehicle_of
from offpiste.training.prediction import predict_windows


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return with_mirrored(dataset_with_features(tmp_path_factory.mktemp("mirrored") / "dataset.zarr"))


def windows_of(dataset: Dataset) -> tuple[Windows, np.ndarray, np.ndarray]:
    """The windows that train, and the numbers of some of the first drive and of their images."""
    windows = Windows(dataset, "train")
    names = np.array(windows.drive_names)[windows.drive]
    own, images = (np.flatnonzero(names == name)[::100] for name in ("circle-0", "circle-0 mirrored"))
    assert len(own) == len(images) > 1
    return windows, own, images


def test_drives_that_train_are_there_twice(dataset: Dataset) -> None:
    mirrored = [drive.name for drive in dataset.drives if drive.name.endswith(" mirrored")]
    assert mirrored == [f"circle-{number} mirrored" for number, part in enumerate(PARTS) if part == "train"]
    for part in ("validation", "test"):
        windows = Windows(dataset, part)
        assert not any(windows.drive_names[drive] in mirrored for drive in windows.drive)


def test_the_bicycle_predicts_the_image_of_what_it_predicts(dataset: Dataset) -> None:
    windows, own, images = windows_of(dataset)
    bicycle = build("parametric", vehicle_of(dataset), seed=0)
    before, after = (predict_windows(bicycle, windows[numbers]).state for numbers in (own, images))
    assert (before[..., 5].abs().amax(dim=1) > 0.05).all(), "the vehicle turns"
    torch.testing.assert_close(after, before * torch.as_tensor(MIRRORED_STATE), atol=1e-4, rtol=1e-4)


def test_a_wheel_finds_what_the_other_side_found(dataset: Dataset) -> None:
    windows, own, images = windows_of(dataset)
    before, after = (windows.gather(numbers) for numbers in (own, images))
    assert before.ground is not None
    assert after.ground is not None
    for wheel, other in ((0, 1), (1, 0), (2, 3), (3, 2)):
        looks = [
            batch.ground.features[batch.ground.ahead[..., side]] for batch, side in ((before, other), (after, wheel))
        ]
        torch.testing.assert_close(*looks, equal_nan=True)
        normal = before.terrain.normal[:, :, other] * torch.tensor([1.0, -1.0, 1.0])
        torch.testing.assert_close(after.terrain.normal[:, :, wheel], normal)
