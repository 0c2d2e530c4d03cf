"""What docs/reliability.md promises: the tests that it names exist, and a full disk ends in one line."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from feature_datasets import dataset_with_features
from offpiste.dataset.store import open_dataset
from offpiste.training.config import TrainConfig
from offpiste.training.run import build, save_run, vehicle_of
from tests.fuzz.recordings import driven, rig_text, write_csv

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reliability.md"
NAMED = sorted(set(re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", PAGE.read_text("utf-8"))))

FULL = """
import resource, sys
from offpiste.cli import main
largest = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
for line in sys.argv[2:]:
    try:
        main(line.split())
    except SystemExit as exit_:
        print("exit", exit_.code, flush=True)
"""
"""Runs commands in a process that can write no large file: what a full disk does, without filling one."""


def test_the_page_names_tests() -> None:
    assert len(NAMED) > 20


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_every_named_test_exists(file: str, name: str) -> None:
    tree = ast.parse((ROOT / file).read_text("utf-8"))
    assert not name or name in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_a_full_disk_ends_in_one_line_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "data.zarr", rows=560)
    model = build("b", vehicle_of(dataset), seed=0)
    save_run(tmp_path / "run", model, TrainConfig(model="b"), dataset, torch.ones(5))
    write_csv(driven(), tmp_path / "drive.csv")
    (tmp_path / "rig.toml").write_text(rig_text("csv"))
    quick = "--epochs 1 --bicycle-epochs 1 --actuator-epochs 1 --stride 100 --batch 2"
    lines = [
        f"extract {tmp_path}/drive.csv --rig {tmp_path}/rig.toml --out {tmp_path}/new.zarr --processes 1",
        f"train {tmp_path}/data.zarr --model b --out {tmp_path}/trained {quick}",
        f"evaluate {tmp_path}/run --dataset {tmp_path}/data.zarr --lookup recorded --out {tmp_path}/report",
    ]
    done = subprocess.run(
        [sys.executable, "-c", FULL, "9000", *lines], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.stdout.count("exit 1\n") == len(lines), done.stdout + done.stderr
    errors = [line for line in done.stderr.splitlines() if not re.search(r" \d+ of \d+ \(", line)]  # but progress
    assert len(errors) == len(lines), done.stderr
    assert all("cannot be written" in error and "make room" in error for error in errors), errors
    assert not (tmp_path / "new.zarr").exists()
    assert not (tmp_path / "trained" / "model.json").exists()
    assert not (tmp_path / "report" / "metrics.json").exists()
    left = [path.name for path in tmp_path.rglob(".*")]
    assert left == [".offpiste-report"], "no partial file but the mark of an unfinished report"
    assert len(open_dataset(tmp_path / "data.zarr").drives) == 4
