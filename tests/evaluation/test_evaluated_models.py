"""Where models that are evaluated together read the terrain."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from factories import COMMANDED
from feature_datasets import dataset_with_features, with_snapshots
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset
from offpiste.dynamics import MODELS
from offpiste.evaluation.evaluate import EvaluatedModel, by_split, evaluate_models, named_apart, readings_of
from offpiste.training.run import vehicle_of

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
    assert "not evaluated on the map: windows of the split fold:0/3, fold:1/3, fold:2/3 have no map" in caplog.text
    assert found.windows.usual_step(0) == 50, "none is evaluated on its few windows with a snapshot instead"
    datasets = [each for each, _ in by_split(models(dataset, folds=True), dataset)]
    assert readings_of(datasets, "test", ("map",), ("10",)) == [("recorded", "10")]


@pytest.mark.parametrize(
    ("runs", "labels"),
    [
        ({"runs/b": 0, "runs/b-longer": 0}, ["b", "b (b-longer)"]),
        ({"runs/b-0": 0, "runs/b-1": 1}, ["b", "b"]),
        ({"any": 0, "other": 1}, ["b", "b"]),
        ({"b-0": 0, "b-1": 1, "long-0": 0, "long-1": 1}, ["b", "b", "b (long)", "b (long)"]),
        ({"s/b": 0, "t/b": 0}, ["b (s/b)", "b (t/b)"]),
        ({"b": 0, "b-0": 0}, ["b", "b (b-0)"]),
    ],
)
def test_runs_of_one_seed_are_named_by_their_folders(runs: dict[str, int], labels: list[str]) -> None:
    dynamics = MODELS["b"](COMMANDED, seed=0)
    models = [EvaluatedModel("b", dynamics, seed=seed) for seed in runs.values()]
    beside = EvaluatedModel("parametric", dynamics, seed=0)
    found = named_apart([*models, beside], [*map(Path, runs), Path("b")])
    assert [model.label for model in found] == [*labels, "parametric"]
    assert [model.seed for model in found] == [*runs.values(), 0]


def test_a_run_that_is_given_twice_stays_one_and_folds_stay_together() -> None:
    dynamics = MODELS["b"](COMMANDED, seed=0)
    twice = [EvaluatedModel("b", dynamics, seed=0)] * 2
    assert [model.label for model in named_apart(twice, [Path("b")] * 2)] == ["b", "b"], "refused later"
    folds = [EvaluatedModel("b", dynamics, seed=0, fold=n, split=split) for n, split in enumerate(FOLDS)]
    labels = [model.label for model in named_apart([*folds, *folds], [Path("cv")] * 3 + [Path("cv2")] * 3)]
    assert labels == 3 * ["b (cv)"] + 3 * ["b (cv2)"]
