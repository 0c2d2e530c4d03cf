"""Where models that are evaluated together read the terrain."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch

from feature_datasets import dataset_with_features, with_snapshots
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset
from offpiste.dynamics import MODELS
from offpiste.evaluation.evaluate import evaluate_models
from offpiste.evaluation.evaluated_models import EvaluatedModel, by_split, readings_of
from offpiste.training.build import vehicle_of

FOLDS = [parse_split(f"fold:{number}/3") for number in range(3)]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Maps as they were at some windows of every drive, and no other maps."""
    folder = tmp_path_factory.mktemp("data")
    parts = ("train", "validation", "test")
    whole = dataset_with_features(folder / "seen.zarr", parts, rows=3300, speeds=(2.5, 3.0))
    snapped = with_snapshots(whole, folder / "snapshots", [300, 600, 900])
    return replace(snapped, drives=tuple(replace(drive, load_map=None) for drive in snapped.drives))


def models(dataset: Dataset, folds: bool) -> Sequence[EvaluatedModel]:
    parametric = MODELS["parametric"](vehicle_of(dataset), seed=0)
    if not folds:
        return [EvaluatedModel("parametric", parametric)]
    return [EvaluatedModel("parametric", parametric, fold=n, split=split) for n, split in enumerate(FOLDS)]


def test_windows_with_snapshots_are_read_on_them(dataset: Dataset) -> None:
    (group,) = by_split(models(dataset, folds=False), dataset)
    assert readings_of([group[0]], "test", ("recorded", "map"), ("10",)) == [("recorded", "10"), ("map", None)]


def test_folds_of_a_dataset_with_snapshots_are_evaluated_at_recorded_places(
    dataset: Dataset, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    settings = {"scale": torch.ones(5), "starts": ("causal",), "stride": 50}
    found = evaluate_models(models(dataset, folds=True), dataset, **settings)
    assert {row.lookup for row in found.metrics.results if row.model == "parametric"} == {"recorded"}
    assert "not evaluated on the map: windows of the split fold:0/3, fold:1/3, fold:2/3 have none" in caplog.text
    assert found.windows.usual_step(0) == 50, "none is evaluated on its few windows with a snapshot instead"
    datasets = [each for each, _ in by_split(models(dataset, folds=True), dataset)]
    assert readings_of(datasets, "test", ("map",), ("10",)) == [("recorded", "10")]
