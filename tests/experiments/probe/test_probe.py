"""The probe on made-up ground whose answer is known, on a real replay of a few seconds, and from end to end."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from experiments.arrays import save_arrays
from experiments.probe.__main__ import Probe
from experiments.probe.cells import GROUND, SeenCells, see_cells
from experiments.probe.scores import fit_ridge, pool, probe_rows
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import PerceptionError
from offpiste.logs import open_log
from offpiste.logs.ground_truth import GROUND_PROPERTIES, WHEELS_TOPIC
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.perception.backbones import open_backbone
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.perception.pca import Moments, fit, save_pca
from offpiste.rig.rig import load_rig
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings

FRICTION = np.array([0.6, 0.45, 0.65, 0.55, 0.3, 0.5, 0.35])
"""Of the made-up ground kinds."""
NOISE_BY_SET = dict(zip(FEATURE_SETS, (0.5, 0.5, 0.5, 0.5, 1.0, 2.0, 4.0, 8.0), strict=True))


def test_the_fit_is_the_textbooks_and_a_constant_feature_changes_nothing() -> None:
    rng, n = np.random.default_rng(0), 4000
    standard = rng.normal(size=(n, 3))
    y = 3 + standard @ np.array([2.0, -1.0, 0.0]) + rng.normal(size=n)
    x, folds = standard * [1.0, 100.0, 0.01] + [0.0, 500.0, 1.0], np.arange(n) * 5 // n
    ridge = fit_ridge(x, y, folds, penalties=(0.3,))
    standard = (x - x.mean(axis=0)) / x.std(axis=0)
    wanted = np.linalg.solve(standard.T @ standard + 0.3 * n * np.eye(3), standard.T @ (y - y.mean()))
    np.testing.assert_allclose(ridge.predict(x), y.mean() + standard @ wanted, rtol=1e-9)
    constant = fit_ridge(np.column_stack((x, np.full(n, 7.0))), y, folds, penalties=(0.3,))
    later = np.column_stack((x, np.full(n, 1e6)))
    np.testing.assert_allclose(constant.predict(later), ridge.predict(x), rtol=1e-9)


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


def test_the_ceiling_is_above_the_probe_which_explains_its_share_of_the_variance() -> None:
    """Least squares on a one-hot code with noise of variance v explains s / (s + v) of it, s = 1/7 being its own."""
    train, test = (pool([made_up(seed), made_up(seed + 1)]) for seed in (0, 2))
    rows = probe_rows(train, test, "made up")

    def by(name: str, trained: str, feature_set: str) -> dict:
        wanted = {"target": "friction", "input": name, "trained": trained, "feature_set": feature_set}
        (found,) = [row for row in rows if wanted.items() <= row.items()]
        return found

    ceiling, visual, floor = (by(name, "hindsight", "hindsight") for name in ("kind", "visual", "brightness"))
    assert ceiling["r2"] == pytest.approx(1 - 0.01**2 / FRICTION.var(), abs=0.01)
    assert ceiling["r2"] > visual["r2"] > 0.3 > 0.05 > abs(floor["r2"])
    assert np.isnan(visual["r2_ci95"]).all(), "too few drives"
    for name in ("hindsight", "10", "20"):
        wanted = (1 / 7) / (1 / 7 + NOISE_BY_SET[name] ** 2)
        assert by("visual", "same", name)["r2"] == pytest.approx(wanted, abs=0.06)


def filterbank_looking(logs: Sequence[str] = ()) -> FeatureExtractor:
    backbone = open_backbone("filterbank")
    vectors = np.random.default_rng(0).normal(size=(500, backbone.channels))
    return FeatureExtractor(backbone, fit(Moments.of(vectors), backbone, components=5, logs=logs))


def test_cells_carry_the_truth(tmp_path: Path) -> None:
    log = tmp_path / "mojave-3.mcap"
    simulate(DriveSettings(WorldSettings("mojave", seed=3, size=120.0, resolution=0.5), 5.0, seed=1), log)
    seen, truth = (
        see_cells(log, load_rig("proving_ground"), filterbank_looking()),
        list(open_log(log).messages(WHEELS_TOPIC)),
    )
    assert seen.features.shape == (8, len(seen.row), 5)
    assert seen.valid[0].mean() > 0.5
    assert (np.isfinite(seen.colour).all(axis=2) == seen.valid).all()
    np.testing.assert_allclose(seen.ground[:, : len(GROUND) - 1].sum(axis=1), 1.0, atol=1e-4)
    # What the tyres felt when they entered the cell, but for half a cell of ground that changes.
    friction = [points_from_message(message)[GROUND_PROPERTIES[0]].mean() for _, message in truth]
    felt = np.interp(seen.row * 0.02, [time - truth[0][0] for time, _ in truth], friction)
    assert np.corrcoef(felt, seen.properties[:, 0])[0, 1] > 0.7


def test_the_experiment_resumes(tmp_path: Path) -> None:
    """Cells that lie there are not extracted again: the drives themselves are empty files."""
    extractor = filterbank_looking()
    save_pca(tmp_path / "pca.safetensors", extractor.pca)
    (tmp_path / "drives").mkdir()
    for number, name in enumerate(("a-1", "a-2")):
        (tmp_path / "drives" / f"{name}.mcap").touch()
        save_arrays(made_up(number, cells=600), tmp_path / "cells" / extractor.identity / f"{name}.npz")
    Probe(out=tmp_path, worlds=("a",), seeds=(1,), test_seeds=(2,)).run()
    result = json.loads((tmp_path / "probe.json").read_text())
    assert {row["worlds"] for row in result["probes"]} == {"a"}


def test_no_drive_is_in_training_and_test(tmp_path: Path) -> None:
    with pytest.raises(PerceptionError, match="is in training and test"):
        Probe(out=tmp_path, seeds=(1, 2), test_seeds=(2,)).run()
    save_pca(tmp_path / "pca.safetensors", filterbank_looking(["dunes-2"]).pca)
    with pytest.raises(PerceptionError, match="dunes-2"):
        Probe(out=tmp_path, seeds=(1,), test_seeds=(2,)).run()
