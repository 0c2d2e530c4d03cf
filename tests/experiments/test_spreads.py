"""Ways to predict errors, on members whose truth is known, and from end to end on a small dataset."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments.command import run as run_command
from experiments.spreads import Members, Spreads, errors_by_ways, fitted_ways, mean_of
from feature_datasets import dataset_with_features
from offpiste.core.errors import RunError
from offpiste.training.config import TrainConfig
from offpiste.training.train import train
from offpiste.uncertainty.calibration import AT, NOMINAL

MOMENTS = 25


def drawn(seed: int, windows: int = 1500, runs: int = 5) -> Members:
    """Members and the truth are drawn about the same unknown place, so members deviate as errors do."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-3, 3, (windows, 1)) * np.ones(MOMENTS)
    size = (0.2 + rng.random((windows, 1))) * np.linspace(0.2, 5, MOMENTS)
    centre = rng.normal(size=(windows, MOMENTS, 2))
    ahead, aside = np.stack((np.cos(heading), np.sin(heading)), -1), np.stack((-np.sin(heading), np.cos(heading)), -1)

    def place() -> np.ndarray:
        along, across = rng.normal(size=(2, windows, 1)) * size
        return centre + along[..., None] * ahead + 0.3 * across[..., None] * aside

    members = np.stack([place() for _ in range(runs)])
    scale = np.stack((size, 0.3 * size), axis=-1)[None].repeat(runs, axis=0)
    return Members(members, scale, np.broadcast_to(heading, members.shape[:-1]), place(), size[:, 0])


def test_the_mean_of_members_is_nearer_and_their_deviation_is_along_the_heading():
    found = drawn(0)
    error, deviation = mean_of(found)
    alone = np.linalg.norm(found.place[0] - found.target, axis=-1).mean()
    assert np.linalg.norm(error, axis=-1).mean() < 0.9 * alone
    assert deviation[..., 1].mean() == pytest.approx(0.3 * deviation[..., 0].mean(), rel=0.05)


def test_calibrated_ways_hold_what_they_should_on_windows_they_were_not_fitted_to():
    ways = errors_by_ways(drawn(1), fitted_ways(drawn(0)), freedom=1e6)
    for name, tolerance in (("ensemble", 0.03), ("both", 0.03)):
        covered = (ways[name].within[..., None] <= np.array(NOMINAL)).mean(axis=0)
        np.testing.assert_allclose(covered, np.broadcast_to(NOMINAL, covered.shape), atol=tolerance, err_msg=name)
    raw = (ways["ensemble as it is"].within[:, -1, None] <= np.array(NOMINAL)).mean(axis=0)
    assert (raw < np.array(NOMINAL) - 0.05).all(), "five members alone are too sure"
    assert ways["fitted"].error[:, AT].shape == (1500, 3, 2)


def test_the_command_compares_runs_on_a_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset = dataset_with_features(tmp_path / "dataset.zarr")
    for seed in (0, 1):
        config = TrainConfig(model="dc", epochs=1, bicycle_epochs=1, actuator_epochs=1, batch=64, stride=80, seed=seed)
        train(dataset, config, tmp_path / f"dc-{seed}")
    given = ["--runs", str(tmp_path / "dc-0"), str(tmp_path / "dc-1"), "--dataset", str(dataset.path), "--quick"]
    run_command(Spreads, [*given, "--out", str(tmp_path / "out")])
    rows = json.loads((tmp_path / "out" / "spreads.json").read_text("utf-8"))["rows"]["dataset.zarr"]
    assert {row["run"] for row in rows} == {"fitted", "ensemble as it is", "ensemble", "both"}
    for row in rows:
        assert sorted(row["coverage"]) == row["coverage"], "larger regions hold more"
        assert row["crps_m"] > 0
    assert "written" in capsys.readouterr().out
    with pytest.raises(RunError, match="1 runs of the models dc"):
        Spreads((tmp_path / "dc-0",), dataset.path).run()
