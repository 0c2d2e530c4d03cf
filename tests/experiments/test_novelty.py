"""Kinds of ground that are held out: found from their properties, and recognised where they look apart."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from experiments.novelty import SeenCells, held_out_rows, kinds_of, novelty_table, refuse_unlike, seen_cells
from feature_datasets import FEATURES, dataset_with_features
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import DatasetError
from offpiste.dataset.store import Dataset
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.world.ground import property_table
from offpiste.uncertainty.novelty import NoveltySettings


def test_kinds_are_found_however_wet_and_mixtures_are_none():
    dry, wet = property_table()
    every = np.arange(len(GROUND_KINDS))
    for wetness in (0.0, 0.33, 1.0):
        assert np.array_equal(kinds_of((1 - wetness) * dry + wetness * wet), every)
    assert kinds_of((dry[:1] + dry[1:2]) / 2).tolist() == [-1]


def seen(seed: int) -> SeenCells:
    """Three kinds of ground, of which the third looks like the second, from two distances."""
    rng = np.random.default_rng(seed)
    kind, seen_from = rng.integers(0, 3, 3000), np.repeat([0, 5], 1500)
    features = rng.normal(size=(3000, 6))
    features[:, 0] += np.where(kind == 0, 8.0, 0.0)
    return SeenCells(torch.from_numpy(features.astype(np.float32)), kind, seen_from)


def test_a_kind_that_looks_apart_is_novel_and_one_that_does_not_is_known():
    parts = {"train": seen(0), "validation": seen(1), "test": seen(2)}
    rows = {(row["kind"], row["set"]): row for row in held_out_rows(parts, NoveltySettings())}
    assert len(rows) == 6
    for name in (FEATURE_SETS[0], FEATURE_SETS[5]):
        apart, alike = rows[GROUND_KINDS[0], name], rows[GROUND_KINDS[2], name]
        assert apart["area"] > 0.98
        assert apart["novel"] > 0.9
        assert 0.4 < alike["area"] < 0.6
        assert max(apart["false"], alike["false"], alike["novel"]) < 0.05
    assert "packed_sand" in novelty_table(list(rows.values())).markdown()


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("novelty") / "dataset.zarr")


def test_features_are_those_of_the_cells(dataset: Dataset) -> None:
    drive = dataset.drives[0]
    cells = drive.rows.cells
    true = replace(drive, rows=replace(drive.rows, cells=replace(cells, features=cells.features[..., :4])))
    found = seen_cells(drive, true, 2, 50, np.random.default_rng(0))
    assert found.features.shape == (50, FEATURES)
    assert found.features.isfinite().all()
    assert (found.kind == -1).all(), "random features are no properties of ground"
    stored = drive.rows.cells.features[2].astype(np.float32)
    assert all((np.abs(stored - one).sum(axis=1) == 0).any() for one in found.features.numpy())


def test_a_dataset_without_the_true_ground_is_refused(dataset: Dataset) -> None:
    with pytest.raises(DatasetError, match="has no true ground"):
        refuse_unlike(dataset, dataset)
