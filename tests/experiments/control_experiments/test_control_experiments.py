"""Control experiments from end to end on a made-up reproduction: gains, files, reused results."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from experiments.control_experiments.__main__ import ControlExperiment
from experiments.control_experiments.reproduced import open_reproduction
from experiments.control_experiments.runs import trained
from experiments.control_experiments.strata import strata, strata_control
from feature_datasets import dataset_with_features
from offpiste.core.errors import RunError
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_windows import BANDS, REVERSE
from offpiste.reproduction.runs import errors_path
from offpiste.reproduction.settings import Size
from offpiste.training.checkpoint import load_json, save_json
from offpiste.training.config import TrainConfig
from offpiste.training.run import save_run

TINY = Size("tiny", (30.0, 15.0, 15.0), stride=320, train=TrainConfig(epochs=1, bicycle_epochs=1, batch=64, stride=80))


@pytest.fixture(scope="module")
def reproduction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reproduced")
    dataset_with_features(folder / "dataset.zarr", rows=3000, yaw_rate=0.08, cells=800)
    save_json(folder / "settings.json", {"size": asdict(TINY), "dataset": "simulated"})
    of = open_reproduction(folder)
    for model in ("b", "dc"):
        config = of.member(model).config(of.size, 0, "cpu")
        run = trained(of.dataset, config, folder / "runs")
        if model == "dc":  # so little training is worse than the physics alone, which is kept and reads no features
            for parameter in run.dynamics.parameters():
                parameter.data += 0.1 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(0))
            save_run(run.folder, run.dynamics, config, of.dataset, run.scale)
    return folder


def test_what_is_no_reproduction_is_said_in_a_line(tmp_path: Path, reproduction: Path) -> None:
    with pytest.raises(RunError, match=r"settings\.json"):
        open_reproduction(tmp_path)
    with pytest.raises(RunError, match="no finished run of 'cf'"):
        open_reproduction(reproduction).runs("cf")
    with pytest.raises(RunError, match="log is missing"):
        open_reproduction(reproduction).logs()
    save_json(tmp_path / "settings.json", {"size": {}})
    with pytest.raises(RunError, match="lacks or misstates"):
        open_reproduction(tmp_path)


def test_a_finished_run_of_other_settings_or_data_is_not_reused(reproduction: Path, tmp_path: Path, caplog) -> None:
    of = open_reproduction(reproduction)
    config, runs = of.member("b").config(of.size, 0, "cpu"), tmp_path / "runs"
    shutil.copytree(reproduction / "runs" / "b-0", runs / "b-0")
    assert trained(of.dataset, config, runs).folder == runs / "b-0"
    with pytest.raises(RunError, match=r"b-0: holds a run of other settings \(epochs 1 then, 9 now\); give the same"):
        trained(of.dataset, replace(config, epochs=9), runs)
    fewer = replace(of.dataset, drives=of.dataset.drives[1:])
    with pytest.raises(RunError, match="b-0: holds a run of another dataset, or of this one before it changed"):
        trained(fewer, config, runs)
    path = runs / "b-0" / "config.json"
    before = load_json(path)
    del before["dataset_sha256"]
    save_json(path, before)
    doubt = "does not say what data it is of"
    assert doubt not in caplog.text
    trained(fewer, config, runs)
    assert doubt in caplog.text


def test_experiments_refuse_a_reproduction_that_was_made_anew_with_another_size(reproduction: Path, tmp_path) -> None:
    folder, out = tmp_path / "reproduced", tmp_path / "controls"
    shutil.copytree(reproduction, folder)
    ControlExperiment("strata", folder, out).run()
    older = load_json(out / "settings.json")
    more_seeds = {"size": asdict(replace(TINY, seeds=5)), "dataset": "simulated"}
    save_json(folder / "settings.json", more_seeds)
    ControlExperiment("strata", folder, out).run()
    save_json(out / "settings.json", older | {"size": older["size"] | {"stride": 7}})
    with pytest.raises(RunError, match=r"was begun with other settings \(size.stride\)"):
        ControlExperiment("strata", folder, out).run()


def test_gains_by_speed_world_and_seed_from_errors_that_are_found_once(reproduction: Path, tmp_path: Path) -> None:
    shutil.copytree(reproduction, tmp_path / "reproduced")
    of = open_reproduction(tmp_path / "reproduced")
    windows = Windows(of.dataset, "test")
    found = strata(windows, np.arange(len(windows)))
    bands = {REVERSE, *(band.name for band in BANDS)}
    assert sum(among.sum() for name, among in found.items() if name in bands) == len(windows)
    assert found["circle"].all()
    page = strata_control(of, tmp_path / "controls")
    gains = json.loads((page.parent / "control.json").read_text("utf-8"))["gains"]
    assert [gain["lookup"] for gain in gains if not gain["case"]] == ["map", *["recorded"] * 4]
    whole, seed = gains[0], next(gain for gain in gains if gain["case"] == "seed 0")
    assert seed["error_m"] == whole["error_m"], "one seed is all of them"
    kept = errors_path(of.folder / "runs" / "b-0", ("map", None))
    written = kept.stat().st_mtime_ns
    strata_control(of, tmp_path / "controls")
    assert kept.stat().st_mtime_ns == written
