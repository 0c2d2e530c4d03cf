"""The cached fit of the actuators: the same weights whether fitted or read, and never those of other inputs."""

import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

import kill
from factories import circle_rows, small_rig
from offpiste.core.cache import VARIABLE
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset, StoredDrive, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics.models import initial_actuators
from offpiste.training import actuator_stage
from offpiste.training.actuator_stage import stage_key
from offpiste.training.config import TrainConfig
from offpiste.training.losses import FITTED_STEPS, actuator_loss, actuator_variance
from offpiste.training.run import vehicle_of
from offpiste.training.train import train

QUICK = TrainConfig("b", epochs=1, bicycle_epochs=1, actuator_epochs=2, stride=60, batch=32)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("steering")
    kill.recorded_steering(folder)
    return open_dataset(folder / "features.zarr")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache" / "stages"


def files(run: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in run.glob("*.safetensors")}


def epochs(run: Path) -> list[dict]:
    return [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]


def test_a_second_run_reads_the_fit_of_the_first(
    dataset: Dataset, cache: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    train(dataset, QUICK, tmp_path / "fitted")
    assert "actuators: fitted, and cached for other runs in" in caplog.text
    caplog.clear()
    train(dataset, replace(QUICK, model="dc"), tmp_path / "other")
    assert f"actuators: read from {cache}" in caplog.text
    train(dataset, QUICK, tmp_path / "taken")
    assert files(tmp_path / "taken") == files(tmp_path / "fitted")
    assert [e for e in epochs(tmp_path / "taken") if e["stage"] == "actuators"] == epochs(tmp_path / "fitted")[:2]
    assert len(list(cache.iterdir())) == 1


def test_damaged_entries_and_caches_that_cannot_be_written_are_ignored(
    dataset: Dataset, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    train(dataset, QUICK, tmp_path / "first")
    (entry,) = cache.iterdir()
    whole = entry.read_bytes()
    entry.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    train(dataset, QUICK, tmp_path / "again")
    assert "cannot be used, so the actuators are fitted again" in caplog.text
    assert files(tmp_path / "again") == files(tmp_path / "first")
    assert load_file(entry).keys() == load_file(tmp_path / "first" / "actuators.safetensors").keys()
    caplog.set_level(logging.INFO)
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file"))
    train(dataset, QUICK, tmp_path / "uncached")
    assert "actuators: fitted; not cached for other runs" in caplog.text


def test_the_key_depends_on_all_inputs_of_the_fit(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = vehicle_of(dataset)

    def key(config: TrainConfig = QUICK, *, processes: int = 1, part: str = "train", **changed: object) -> str:
        of = [Windows(dataset, name, start=config.start).without_terrain(FITTED_STEPS) for name in (part, "validation")]
        return stage_key(*of, replace(vehicle, **changed), config, processes)

    settings = {"seed": 1, "batch": 31, "stride": 3, "actuator_epochs": 3, "start": "smoothed", "learning_rate": 0.1}
    others = [key(replace(QUICK, **{name: value})) for name, value in settings.items()]
    others += [key(processes=2), key(part="test"), key(actuators=())]
    monkeypatch.setattr(actuator_stage, "sources_digest", lambda sources: "other")
    others.append(key())
    monkeypatch.undo()
    assert len({key(), *others}) == len(others) + 1
    alike = replace(QUICK, model="dc", epochs=7, bicycle_epochs=9, codes=2, refit_constants=True)
    assert key(alike) == key() == key(mass=1.0, codes=2)


def test_the_loss_depends_on_motion_alone(dataset: Dataset) -> None:
    windows, lags = Windows(dataset, "train"), initial_actuators(vehicle_of(dataset), 0)
    loss = actuator_loss(lags, windows)
    index = np.arange(0, len(windows), 50)
    with torch.no_grad():
        whole = loss(windows.gather(index))
        assert torch.equal(loss(windows.without_terrain().gather(index)), whole)
        assert torch.equal(loss(windows.without_terrain(FITTED_STEPS).gather(index)), whole)


@pytest.mark.parametrize("seed", range(2))
def test_an_actuator_is_scaled_by_all_training_rows(seed: int) -> None:
    """Gaps leave stretches hardly longer than a window, and the brake is applied rarely."""
    rng, count = np.random.default_rng(seed), 16_000
    rows, valid = circle_rows(count, seed=seed), np.ones(count, bool)
    brake = 0.6 * (rng.random(count // 200) < 0.1).repeat(200)
    actuators = np.stack((brake, np.sin(np.arange(count) / 50), *np.zeros((2, count)))).T.astype(np.float32)
    for gap in np.cumsum(rng.integers(270, 330, 60)):
        valid[gap : gap + 15] = False
    rows = replace(rows, actuators=actuators, actuators_causal=actuators, valid=valid)
    split = parse_split("blocks:1,0,0")
    part = split.label("drive", rows.state[:, :2] + rows.origin)
    gaps = Dataset(Path("memory"), small_rig(), split, (StoredDrive("drive", rows, part, ()),))
    found = actuator_variance(Windows(gaps, "train"))
    np.testing.assert_allclose(found[:2], actuators[:, :2].var(axis=0), rtol=0.35)


def test_of_many_windows_fewer_are_used_with_a_larger_stride(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def run_stage(stage, windows, validation, config, *others):  # type: ignore[no-untyped-def]
        seen.append(config)
        return kept_as_it_was(stage, windows, validation, config, *others)

    kept_as_it_was = actuator_stage.run_stage
    monkeypatch.setattr(actuator_stage, "run_stage", run_stage)
    windows, validation = Windows(dataset, "train"), Windows(dataset, "validation")
    lags = initial_actuators(vehicle_of(dataset, QUICK), 0)
    few = len(windows) // 100
    for most, largest, stride, batch in ((100_000, 1024, 60, 32), (few, 16, len(windows) // few, 16)):
        monkeypatch.setattr(actuator_stage, "LARGEST_EPOCH", most)
        monkeypatch.setattr(actuator_stage, "LARGEST_BATCH", largest)
        monkeypatch.setenv(VARIABLE, str(tmp_path / f"cache-{most}"))
        folder = tmp_path / str(most)
        folder.mkdir()
        actuator_stage.fit_actuators(lags, QUICK, windows, validation, folder, lambda line: None)
        assert (seen[-1].stride, seen[-1].batch, seen[-1].device) == (stride, batch, "cpu")
