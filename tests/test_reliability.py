"""Promises of docs/reliability.md: the named tests exist, and a full disk ends in one line."""

import re
from pathlib import Path

import torch

from feature_datasets import dataset_with_features
from offpiste.dataset.store import open_dataset
from offpiste.training.config import TrainConfig
from offpiste.training.run import build, save_run, vehicle_of
from tests.fuzz.recordings import driven, rig_text, write_csv
from warm import run_warm

ROOT = Path(__file__).parents[1]

FULL = """
import os, resource, sys
sys.dont_write_bytecode = True  # cached bytecode would be cut as well
from offpiste.cli import main
largest = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
os.chdir(sys.argv[2])
for line in sys.argv[3:]:
    try:
        main(line.split())
    except SystemExit as exit_:
        print("exit", exit_.code, flush=True)
"""
"""Runs commands in a process that cannot write large files, as on a full disk."""


def test_every_named_test_exists() -> None:
    named = set(re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", (ROOT / "docs" / "reliability.md").read_text("utf-8")))
    assert len(named) > 20
    for file, name in named:
        assert f"def {name}(" in (ROOT / file).read_text("utf-8") or not name, (file, name)


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
    done = run_warm("-c", FULL, "9000", tmp_path, *lines)
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
