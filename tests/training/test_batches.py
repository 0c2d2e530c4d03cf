"""Batches of an epoch: the same whether gathered ahead or not, and mirrored windows."""

import threading
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from feature_datasets import dataset_with_features
from offpiste.core.conventions import WHEELS
from offpiste.core.errors import RunError
from offpiste.dataset.columns import COLUMNS, Column
from offpiste.dataset.feature_sets import per_trajectory
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Batch, Windows
from offpiste.training.batches import OPPOSITE, STATE_SIGNS, Mirror, batches_of, mirror_of, one_ahead
from offpiste.training.config import TrainConfig
from offpiste.training.distributed import Group
from offpiste.training.prediction import predict_batch
from offpiste.training.run import build, vehicle_of
from offpiste.training.train import train


def test_each_is_made_while_the_one_before_is_in_use():
    began = {number: threading.Event() for number in range(4)}

    def make(number):
        began[number].set()
        return 10 * number

    made = one_ahead(make, range(4))
    for number in range(4):
        assert next(made) == 10 * number
        assert number == 3 or began[number + 1].wait(5)
        assert number > 1 or not began[number + 2].is_set()
    assert list(made) == list(one_ahead(make, [])) == []


def test_what_fails_ahead_fails_in_its_turn():
    def make(number):
        if number == 1:
            raise ValueError("the second one")
        return number

    made = one_ahead(make, range(3))
    assert next(made) == 0
    with pytest.raises(ValueError, match="the second one"):
        next(made)


@pytest.mark.parametrize("group", [Group(), Group(1, 3)])
def test_batches_that_are_gathered_ahead_are_those_of_the_same_draws(group, tmp_path):
    windows = Windows(dataset_with_features(tmp_path / "data.zarr", rows=400), "train")
    parts = [np.array(part) for part in ([3, 1, 4], [1], [5, 9, 2, 6])]
    found = []
    for windows.read_ahead in (False, True):
        rng = np.random.default_rng(7)
        found.append(list(batches_of(windows, parts, per_trajectory, rng, group)))
    assert [batch is None for batch in found[0]] == [batch is None for batch in found[1]]
    for one, other in zip(*found, strict=True):
        if one is not None:
            assert torch.equal(one.state, other.state)
            assert torch.equal(one.terrain.normal, other.terrain.normal)
            torch.testing.assert_close(one.ground.features, other.ground.features, rtol=0, atol=0, equal_nan=True)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("mirror") / "dataset.zarr")


@pytest.fixture(scope="module")
def windows(dataset: Dataset) -> Windows:
    return Windows(dataset, "train")


def on_a_slope(batch: Batch) -> Batch:
    """The same windows on ground that rises differently under each wheel."""
    rng = torch.Generator().manual_seed(0)
    normal = torch.randn(batch.terrain.normal.shape, generator=rng) * 0.1 + torch.tensor([0.0, 0.0, 1.0])
    return replace(batch, terrain=replace(batch.terrain, normal=normal / normal.norm(dim=-1, keepdim=True)))


def gathered(windows: Windows) -> tuple[Batch, Mirror, torch.Tensor]:
    batch = on_a_slope(windows.gather(np.arange(0, len(windows), len(windows) // 6)))
    return batch, mirror_of(windows), torch.ones(len(batch.state), dtype=torch.bool)


def test_the_wheel_opposite_is_on_the_same_axle() -> None:
    assert [WHEELS[wheel] for wheel in OPPOSITE] == ["front-right", "front-left", "rear-right", "rear-left"]


def test_the_bicycle_predicts_the_image_of_what_it_predicts(dataset: Dataset, windows: Windows) -> None:
    batch, mirror, every = gathered(windows)
    bicycle = build("parametric", vehicle_of(dataset), seed=0)
    with torch.no_grad():
        before, image = (predict_batch(bicycle, each).state for each in (batch, mirror.of(batch, every)))
    assert (before[..., 4].abs().amax(dim=1) > 0.05).all(), "the vehicle is pushed sideways"
    torch.testing.assert_close(image, before * torch.tensor(STATE_SIGNS), atol=1e-4, rtol=1e-4)


def test_a_wheel_finds_what_the_other_side_found(windows: Windows) -> None:
    batch, mirror, every = gathered(windows)
    image = mirror.of(batch, every)
    for wheel, other in enumerate(OPPOSITE):
        for rows in ("past", "ahead"):
            assert torch.equal(getattr(image.ground, rows)[..., wheel], getattr(batch.ground, rows)[..., other])
        assert torch.equal(image.terrain.known[..., wheel], batch.terrain.known[..., other])
        expected = batch.terrain.normal[..., other, :] * torch.tensor([1.0, -1.0, 1.0])
        assert torch.equal(image.terrain.normal[..., wheel, :], expected)


def same(one: object, other: object) -> bool:
    """Whether all tensors in two nested dataclasses are equal, NaN included."""
    if isinstance(one, torch.Tensor):
        return torch.equal(torch.nan_to_num(one, nan=-7.0), torch.nan_to_num(other, nan=-7.0))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return one == other


def test_the_image_of_the_image_is_the_window_and_windows_not_chosen_stay(windows: Windows) -> None:
    batch, mirror, every = gathered(windows)
    image = mirror.of(batch, every)
    assert not same(image, batch)
    assert same(mirror.of(image, every), batch)
    assert same(mirror.of(batch, ~every), batch)
    half = mirror.of(batch, torch.arange(len(every)) % 2 == 0)
    assert torch.equal(half.target[::2], image.target[::2])
    assert torch.equal(half.target[1::2], batch.target[1::2])


def test_steering_changes_its_sign_and_pedals_do_not(windows: Windows) -> None:
    batch, mirror, every = gathered(windows)
    control = mirror.of(batch, every).control
    names = [control.name for control in windows.dataset.rig.controls]
    for column, name in enumerate(names):
        assert torch.equal(control[..., column], (-1 if name == "steer" else 1) * batch.control[..., column])
    assert mirror.actuators.tolist() == [-1 if "steer" in a.name else 1 for a in windows.dataset.rig.actuators]


def test_training_with_mirrors_is_another_training_and_repeats(dataset: Dataset, tmp_path) -> None:
    config = TrainConfig(model="dc", epochs=1, bicycle_epochs=1, batch=64, stride=80)
    weights = {}
    for name, mirrored in (("without", False), ("with", True), ("again", True)):
        dynamics = train(dataset, replace(config, mirror=mirrored), tmp_path / name)
        weights[name] = torch.cat([value.flatten() for value in dynamics.state_dict().values()])
    assert torch.equal(weights["with"], weights["again"])
    assert not torch.equal(weights["with"], weights["without"])


def test_a_column_without_a_known_image_is_refused(windows: Windows, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = [*COLUMNS.items(), ("wind", Column(read=lambda grid: grid.time, segments=("ahead",)))]
    monkeypatch.setattr(type(COLUMNS), "items", lambda registry: listed)
    with pytest.raises(RunError, match="wind"):
        mirror_of(windows)
