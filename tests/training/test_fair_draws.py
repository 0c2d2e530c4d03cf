"""Fair draws: models of one seed read the same normals in the same order, and networks read no unknown ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from feature_datasets import dataset_with_features
from offpiste.core.conventions import FEATURE_SETS, HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.feature_sets import FeatureSetChoice
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import MODELS
from offpiste.dynamics.torch_physics import unknown_normals
from offpiste.training import loop
from offpiste.training.config import TrainConfig
from offpiste.training.distributed import ALONE
from offpiste.training.prediction import predict_batch
from offpiste.training.run import build, vehicle_of

CONFIG = TrainConfig(batch=16, stride=20, seed=5)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Normals lean by 0.01 for each set, and the further set, the fewer of them are known."""
    made = dataset_with_features(tmp_path_factory.mktemp("fair") / "data.zarr", rows=500)
    rng, lean = np.random.default_rng(0), 0.01 * np.arange(len(FEATURE_SETS))
    one = np.stack((np.sin(lean), 0 * lean, np.cos(lean)), axis=-1)[:, None, None]

    def with_normals(drive):
        unknown = rng.random((len(FEATURE_SETS), len(drive.rows.time), 4)) < 10 * lean[:, None, None]
        normal = np.where(unknown[..., None], np.nan, one).astype(np.float32)
        return replace(drive, rows=replace(drive.rows, normal=normal))

    return replace(made, drives=tuple(with_normals(drive) for drive in made.drives))


def read_by(model: str, dataset: Dataset) -> list[tuple[np.ndarray, Batch]]:
    """Windows and batches of an epoch, as a model's stage reads them."""
    module, read = nn.Linear(1, 1), []

    class Recording(Windows):
        def gather(self, index: np.ndarray, feature_set_choice: FeatureSetChoice | None = None) -> Batch:
            read.append((index, super().gather(index, feature_set_choice)))
            return read[-1][1]

    def loss(batch: Batch) -> Tensor:
        return module.weight.sum().expand(len(batch.state))

    stage = loop.Stage("model", module, loss, 1, MODELS[model].draw)
    loop.train_epoch(stage, loop.StageState(stage, CONFIG), Recording(dataset, "train"), CONFIG, 0, ALONE)
    return read


def test_models_of_one_seed_read_the_same_normals_in_the_same_order(dataset: Dataset) -> None:
    wanted = read_by("b", dataset)
    assert len(wanted) > 1
    for model in ("df", "cf", "dc", "lstm", "parametric"):
        for (_, mine), (_, theirs) in zip(read_by(model, dataset), wanted, strict=True):
            assert torch.equal(mine.terrain.normal, theirs.terrain.normal), model
            assert torch.equal(mine.terrain.known, theirs.terrain.known), model
            assert torch.equal(mine.history.terrain.normal, theirs.history.terrain.normal), model


def test_the_normals_of_a_window_are_of_one_set_which_differs_between_windows(dataset: Dataset) -> None:
    for _, batch in read_by("b-hindsight", dataset):
        assert (batch.terrain.normal == torch.tensor([0.0, 0.0, 1.0])).all()
        assert batch.terrain.known.all()
    sets = []
    for _, batch in read_by("b", dataset):
        for normal, known in zip(batch.terrain.normal, batch.terrain.known, strict=True):
            lean = torch.unique(torch.round(100 * torch.asin(normal[known][:, 0])))
            assert len(lean) == 1
            sets.append(int(lean))
    assert set(sets) == set(range(len(FEATURE_SETS)))


def test_features_of_cf_are_of_hindsight_and_those_of_dc_of_the_normals_set(dataset: Dataset) -> None:
    windows = Windows(dataset, "train")
    for model, of_normals in (("cf", False), ("dc", True)):
        index, batch = read_by(model, dataset)[0]
        drawn = torch.round(100 * torch.asin(batch.terrain.normal[..., 0].flatten(1).amax(dim=1))).long().tolist()
        assert len(set(drawn)) > 3
        for b, (number, row) in enumerate(zip(drawn, windows.row_in_drive(index), strict=True)):
            cells = dataset.drives[windows.drive[index[b]]].rows.cells
            wanted = cells.features[number if of_normals else 0, cells.index[row]].astype(np.float32)
            np.testing.assert_array_equal(batch.ground.features[batch.ground.ahead[b, 0]].numpy(), wanted)


@pytest.mark.parametrize("model", ["dc", "lstm"])
def test_unknown_normals_are_counted_and_not_read(dataset: Dataset, model: str) -> None:
    windows = Windows(dataset, "train", feature_set="40")
    index = windows.every(40)[:4]
    batch = windows.gather(index)
    rows = dataset.drives[windows.drive[index[0]]].rows
    first = windows.row_in_drive(index[:1])[0]
    share = np.isnan(rows.normal[-1, first - HISTORY_STEPS : first + HORIZON_STEPS, :, 0]).mean(axis=1)
    assert 0.4 < share.mean() < 1
    seen = torch.cat((unknown_normals(batch.history.terrain), unknown_normals(batch.terrain)), dim=1)
    np.testing.assert_allclose(seen[0, :, 0], share)
    dynamics = build(model, vehicle_of(dataset, CONFIG), seed=0)
    with torch.no_grad():
        for parameter in dynamics.parameters():
            parameter += 0.1
        states = predict_batch(dynamics, batch).state
        known = replace(batch, terrain=replace(batch.terrain, known=torch.ones_like(batch.terrain.known)))
        if_known = predict_batch(dynamics, known).state
    assert torch.isfinite(states).all()
    assert not torch.equal(states, if_known)
