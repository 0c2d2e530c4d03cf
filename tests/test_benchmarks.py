"""Every script in benchmarks/ runs with --smoke."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from feature_datasets import dataset_with_features
from offpiste.simulation.simulate import DriveSettings, simulate

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "benchmarks"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Callable:
    """Imports a script by its path: packages of tests have the same names."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))

    def load(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(f"benchmark_{name}", BENCHMARKS / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.mark.parametrize("name", ["plan", "mapping", "simulate"])
def test_a_benchmark_without_input_runs(script, name, capsys):
    script(name).main(["--smoke"])
    assert "ms" in (shown := capsys.readouterr().out) or "real time" in shown


def test_the_pictures_of_the_proving_ground_are_written(script, tmp_path):
    script("pictures").main([str(tmp_path), "--smoke"])
    assert "drive.jpg" in {path.name for path in tmp_path.iterdir()}


def test_demo_measures_time_and_memory(script, tmp_path, capsys):
    script("demo").main(["--out", str(tmp_path), "--smoke"])
    assert "GiB" in capsys.readouterr().out


def test_training_steps_are_timed(script, tmp_path, capsys):
    script("train").main(dataset_with_features(tmp_path / "data.zarr").path, smoke=True)
    assert "16 windows" in capsys.readouterr().out


def test_inspection_is_timed(script, tmp_path, capsys):
    log = tmp_path / "drive.mcap"
    simulate(DriveSettings(seconds=9.0, sensors="light"), log)
    script("inspect_log").main(log, scratch=tmp_path / "long.mcap", smoke=True)
    assert "exit code 0" in capsys.readouterr().out


def test_benchmarks_and_package_do_not_import_tests():
    for folder in ("benchmarks", "examples", "experiments", "src"):
        for path in (ROOT / folder).rglob("*.py"):
            assert "feature_datasets" not in path.read_text()
            assert "from tests" not in path.read_text()
