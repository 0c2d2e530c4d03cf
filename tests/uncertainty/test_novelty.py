"""Novel ground: which looks are familiar, what a model makes of others, and what is kept with a run."""

from pathlib import Path

import pytest
import torch

from factories import VEHICLE
from feature_datasets import FEATURES, dataset_with_features
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.errors import DatasetError, RunError
from offpiste.training.build import build
from offpiste.training.checkpoint import load_json, save_json
from offpiste.training.config import TrainConfig
from offpiste.training.run import load_run
from offpiste.training.train import train
from offpiste.uncertainty.novelty import (
    FILE,
    NoveltySettings,
    Wary,
    fit_familiar,
    keep_familiar,
    load_familiar,
    looks_of,
    make_wary,
)


def looks(count: int, seed: int) -> torch.Tensor:
    """Two kinds of ground, which look apart in the first feature; the other features are noise."""
    drawn = torch.randn(count, 4, generator=torch.Generator().manual_seed(seed))
    drawn[:, 0] += torch.where(torch.arange(count) % 2 == 0, -10.0, 10.0)
    return drawn


def test_what_lies_between_familiar_kinds_is_novel():
    familiar = fit_familiar(looks(4000, 0), looks(1000, 1))
    novel = looks(1000, 2)
    novel[:, 0] = torch.randn(1000, generator=torch.Generator().manual_seed(3))
    assert familiar.novel(looks(1000, 4)).float().mean() < 0.03
    assert familiar.novel(novel).float().mean() > 0.97, "their mean is that of all, but none looks like it"


@pytest.mark.parametrize("neighbours", [1, 3])
def test_the_distance_is_the_mean_to_the_nearest_looks(neighbours):
    settings = NoveltySettings(looks=50, neighbours=neighbours, power=1.0)
    training, other = looks(50, 0), looks(20, 1)
    familiar = fit_familiar(training, looks(20, 2), settings)
    scale = training.double().std(dim=0)
    apart = ((other[:, None] - training) / scale).square().sum(dim=-1).sqrt().sort(dim=1).values
    found = familiar.distance(other).double()
    torch.testing.assert_close(found, apart[:, :neighbours].mean(dim=1), rtol=1e-3, atol=1e-3)


def test_the_limit_holds_the_share_of_validation_that_is_to_be_known():
    validation = looks(1000, 1)
    familiar = fit_familiar(looks(4000, 0), validation, NoveltySettings(known=0.9))
    assert familiar.novel(validation).float().mean() == pytest.approx(0.1, abs=0.01)


def test_too_few_looks_are_refused():
    with pytest.raises(DatasetError, match="2 looks of ground for training"):
        fit_familiar(looks(2, 0), looks(50, 1))


def test_a_wary_encoder_takes_novel_cells_as_missing_and_leaves_others():
    torch.manual_seed(0)
    encoder = Compressor(4)
    wary = Wary(encoder, fit_familiar(looks(4000, 0), looks(1000, 1)))
    features, valid = looks(100, 4), torch.rand(100) > 0.3
    features[40:60, 0] = 0.0
    features[~valid] = torch.nan
    novel = torch.zeros(100, dtype=torch.bool)
    novel[valid] = wary.familiar.novel(features[valid])
    assert novel[40:60][valid[40:60]].all()
    codes = wary(features, valid)
    torch.testing.assert_close(codes[novel | ~valid], encoder.missing().expand(int((novel | ~valid).sum()), -1))
    torch.testing.assert_close(codes[valid & ~novel], encoder(features, valid)[valid & ~novel])
    torch.testing.assert_close(wary.missing(), encoder.missing())


def test_a_model_without_features_stays_as_it_is():
    model = build("b", VEHICLE, seed=0)
    make_wary(model, fit_familiar(looks(50, 0), looks(50, 1)))
    assert model.encoder is None


def test_what_is_familiar_is_kept_with_its_run_and_belongs_to_its_weights(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "dataset.zarr")
    config = TrainConfig(model="dc", epochs=1, bicycle_epochs=1, actuator_epochs=1, batch=64, stride=80)
    train(dataset, config, tmp_path / "dc")
    run = load_run(tmp_path / "dc")
    with pytest.raises(RunError, match=r"which ground is familiar.*offpiste calibrate"):
        load_familiar(run)
    familiar = keep_familiar(run, dataset, NoveltySettings(looks=64, candidates=200))
    assert familiar.kept.shape == (64, FEATURES)
    found = looks_of(dataset, "test", 50)
    assert found.isfinite().all()
    assert torch.equal(load_familiar(run).distance(found), familiar.distance(found))
    save_json(run.folder / "model.json", load_json(run.folder / "model.json") | {"weights_sha256": "0" * 64})
    with pytest.raises(RunError, match="belongs to other weights"):
        load_familiar(run)
    assert (run.folder / FILE).exists()
