"""The probe on made-up ground whose answer is known, on a real replay of a few seconds, and from end to end."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from experiments.probe.__main__ import Probe
from experiments.probe.cells import GROUND, SeenCells, save_cells, see_cells
from experiments.probe.scores import (
    fit_probe,
    held_out_cells,
    pool,
    probe_rows,
    score_probe,
)
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import PerceptionError
from offpiste.logs.ground_truth import GROUND_PROPERTIES, read_truth
from offpiste.perception.backbones import open_backbone
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.perception.pca import Moments, fit, save_pca
from offpiste.rig.rig import load_rig
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings

FRICTION = np.array([0.6, 0.45, 0.65, 0.55, 0.3, 0.5, 0.35])
"""Of the made-up ground kinds."""
NOISE_BY_SET = dict(zip(FEATURE_SETS, (0.5, 0.5, 0.5, 0.5, 1.0, 2.0, 4.0, 8.0), strict=True))


def made_up(seed: int, *, cells: int = 1500, missing: float = 0.2) -> SeenCells:
    """Ground in patches of 10 cells; features are its kind and noise that grows with distance; brightness is noise."""
    rng = np.random.default_rng(seed)
    kind = np.repeat(rng.integers(0, 7, cells // 10), 10)
    one_hot = np.eye(7)[kind]
    noise = np.array(list(NOISE_BY_SET.values()))[:, None, None]
    features = one_hot + noise * rng.normal(size=(8, cells, 7))
    valid = rng.uniform(size=(8, cells)) > missing
    properties = np.zeros((cells, len(GROUND_PROPERTIES)))
    properties[:, 0] = FRICTION[kind] + 0.01 * rng.normal(size=cells)
    properties[:, 2] = 0.2 - 0.2 * FRICTION[kind]
    return SeenCells(
        features=np.where(valid[..., None], features, np.nan),
        colour=np.where(valid[..., None], rng.uniform(size=(8, cells, 3)), np.nan),
        valid=valid,
        properties=properties,
        ground=np.column_stack((one_hot, np.zeros(cells))),
        row=np.arange(cells) * 4,
    )


def by(rows: list[dict], **wanted: object) -> dict:
    found = [row for row in rows if all(row[key] == value for key, value in wanted.items())]
    assert len(found) == 1
    return found[0]


@pytest.fixture(scope="module")
def rows() -> list[dict]:
    train, test = (pool([(0, made_up(seed)), (0, made_up(seed + 1))]) for seed in (0, 2))
    return probe_rows(train, test, "made up")


def test_the_ceiling_is_above_the_probe_and_the_probe_above_the_floor(rows: list[dict]) -> None:
    row = {"target": "friction", "trained": "hindsight", "feature_set": "hindsight", "cells": "valid"}
    ceiling, visual, floor, world = (by(rows, input=n, **row) for n in ("kind", "visual", "brightness", "world"))
    # Friction is its kind's and noise of 0.01; its variance over kinds is that of FRICTION, about.
    assert ceiling["r2"] == pytest.approx(1 - 0.01**2 / FRICTION.var(), abs=0.01)
    assert ceiling["r2"] > visual["r2"] > 0.3 > 0.05 > abs(floor["r2"])
    assert abs(floor["rank"]) < 0.1
    assert abs(world["r2"]) < 0.05
    assert ceiling["n"] == visual["n"] == floor["n"]
    assert np.isnan(visual["r2_ci95"]).all(), "too few drives"


def test_what_is_known_ahead_is_the_share_of_the_variance(rows: list[dict]) -> None:
    """Least squares on a one-hot code with noise of variance v explains s / (s + v) of it, s = 1/7 being its own."""
    for name in ("hindsight", "10", "20"):
        found = by(rows, target="friction", trained="same", feature_set=name, cells="valid", input="visual")
        wanted = (1 / 7) / (1 / 7 + NOISE_BY_SET[name] ** 2)
        assert found["r2"] == pytest.approx(wanted, abs=0.06)


def test_cells_that_the_map_did_not_hold_are_neither_trained_nor_tested_on() -> None:
    seen = made_up(0)
    pooled = pool([(0, seen)])
    spoilt = replace(seen, features=np.where(seen.valid[..., None], seen.features, 1e6))
    a, b = (fit_probe(p, "friction", "visual", FEATURE_SETS) for p in (pooled, pool([(0, spoilt)])))
    np.testing.assert_array_equal(a.weights, b.weights)
    assert fit_probe(pool([(0, replace(seen, valid=np.zeros_like(seen.valid)))]), "friction", "visual", ("10",)) is None
    chosen = pooled.cells.valid[4]
    assert score_probe(a, "friction", "visual", held_out_cells(pooled, "10", chosen)).n == chosen.sum()


def filterbank_looking() -> FeatureExtractor:
    backbone = open_backbone("filterbank")
    vectors = np.random.default_rng(0).normal(size=(500, backbone.channels))
    return FeatureExtractor(backbone, fit(Moments.of(vectors), backbone, components=5))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("probe") / "mojave-3.mcap"
    world = WorldSettings("mojave", seed=3, size=120.0, resolution=0.5)
    simulate(DriveSettings(world, 5.0, seed=1, sensors="light"), log)
    return log


def test_cells_carry_the_truth(drive: Path) -> None:
    rig, extractor, truth = load_rig("proving_ground"), filterbank_looking(), read_truth(drive)
    seen = see_cells(drive, rig, extractor)
    assert seen.features.shape == (8, len(seen.row), 5)
    assert seen.valid[0].mean() > 0.5
    assert (np.isfinite(seen.colour).all(axis=2) == seen.valid).all()
    np.testing.assert_allclose(seen.ground[:, : len(GROUND) - 1].sum(axis=1), 1.0, atol=1e-4)
    # What the tyres felt when they entered the cell, but for half a cell of ground that changes.
    felt = np.interp(seen.row * 0.02, truth.time - truth.time[0], truth.properties[:, :, 0].mean(axis=1))
    assert np.corrcoef(felt, seen.properties[:, 0])[0, 1] > 0.7


def test_the_experiment_goes_on_from_what_is_there(tmp_path: Path) -> None:
    """Cells that lie there are not extracted again: the drives themselves are empty files."""
    extractor = filterbank_looking()
    save_pca(tmp_path / "pca.safetensors", extractor.pca)
    experiment = Probe(out=tmp_path, worlds=("a",), seeds=(1,), test_seeds=(2,))
    (tmp_path / "drives").mkdir()
    cells = tmp_path / "cells" / extractor.identity
    for number, name in enumerate(("a-1", "a-2")):
        (tmp_path / "drives" / f"{name}.mcap").touch()
        save_cells(cells / f"{name}.npz", made_up(number, cells=600))
    experiment.run()
    result = json.loads((tmp_path / "probe.json").read_text())
    assert {row["worlds"] for row in result["probes"]} == {"a"}
    assert (tmp_path / "probe_a.png").read_bytes().startswith(b"\x89PNG")


def test_no_drive_is_in_training_and_test(tmp_path: Path) -> None:
    with pytest.raises(PerceptionError, match="is in training and test"):
        Probe(out=tmp_path, seeds=(1, 2), test_seeds=(2,)).run()
    extractor = filterbank_looking()
    fitted = fit(Moments.of(torch.randn(90, extractor.backbone.channels)), extractor.backbone, logs=["dunes-2"])
    save_pca(tmp_path / "pca.safetensors", fitted)
    with pytest.raises(PerceptionError, match="dunes-2"):
        Probe(out=tmp_path, seeds=(1,), test_seeds=(2,)).run()
