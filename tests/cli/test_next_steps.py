"""Suggested next commands, which the command line accepts."""

import shlex
import shutil
from pathlib import Path

import pytest

from feature_datasets import dataset_with_features
from offpiste.cli import next_steps
from offpiste.cli.entry import commands_in_order, parse
from offpiste.cli.extract import Extract
from offpiste.cli.view import View
from offpiste.core.shipped import run_folder
from offpiste.dataset.store import Dataset
from offpiste.training.checkpoint import load_json, save_json
from offpiste.uncertainty.fit import FILE

B = Path("pretrained:proving-ground/b")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return dataset_with_features(tmp_path / "data.zarr", rows=4000)


def command_of(line: str) -> str:
    """The command that a line names, after a check that the command line accepts it."""
    command = line.splitlines()[-1].removeprefix("next: offpiste ")
    parse(shlex.split(command), commands_in_order())
    return command


def trained(to: Path, *, spread: bool, on: str = "elsewhere.zarr") -> Path:
    """A run as `offpiste train` writes it."""
    shutil.copytree(run_folder(B), to)
    if not spread:
        (to / FILE).unlink()
    save_json(to / "model.json", load_json(to / "model.json") | {"dataset": str(Path(on).resolve())})
    return to


def test_an_evaluation_leads_to_a_calibration_only_where_that_is_possible() -> None:
    data = Path("data.zarr")
    mine, other = trained(Path("runs/mine"), spread=False, on="data.zarr"), trained(Path("runs/other"), spread=False)
    ready = trained(Path("runs/ready"), spread=True)
    trained(Path("runs/cv/fold-0"), spread=False, on="data.zarr")
    for runs, expected in (
        ([mine], "calibrate runs/mine --dataset data.zarr"),
        ([mine, ready], "calibrate runs/mine runs/ready --dataset data.zarr"),
        ([other], "export runs/other --to other-c"),
        ([mine, other], "export runs/mine --to mine-c"),
        ([ready], "export runs/ready --to ready-c"),
        ([Path("runs/cv")], "train data.zarr --model b --out runs/b"),
        ([B], f"drive {B} --out closed-loop"),
    ):
        assert command_of(next_steps.after_evaluation(runs, data)) == expected


def test_runs_that_cannot_be_exported_lead_to_one_that_can(monkeypatch: pytest.MonkeyPatch) -> None:
    ready = trained(Path("runs/ready"), spread=True)
    monkeypatch.setattr("offpiste.dynamics.kernels.coverage.uncovered", lambda dynamics: "another network")
    assert command_of(next_steps.after_runs([ready], Path("d.zarr"))) == "train d.zarr --model b --out runs/b"


def test_a_shard_leads_to_the_merge_of_all(dataset: Dataset) -> None:
    options = Extract(("a.csv",), "dart", Path("part-1.zarr"), shard="1/2")
    merge = "merge part-1.zarr ... --out dataset.zarr"
    assert command_of(next_steps.after_extraction(options, dataset)) == merge


def test_a_dataset_leads_to_the_same_training_after_merge_and_view(dataset: Dataset) -> None:
    viewed = next_steps.after_view(View(dataset.path, rig="dart"))
    for line in (next_steps.after_dataset(dataset, dataset.path), viewed):
        model = "dc" if dataset.pca else "parametric"
        assert command_of(line) == f"train {dataset.path} --model {model} --out runs/{model}"
    assert command_of(next_steps.after_view(View(dataset.path, run_folder=B))).startswith(f"drive {B}")


def test_a_viewed_log_leads_to_its_extraction() -> None:
    line = next_steps.after_view(View(Path("drive.mcap"), rig="dart", pca=Path("pca.safetensors")))
    assert command_of(line) == "extract drive.mcap --rig dart --pca pca.safetensors --out dataset.zarr"


def test_places_in_object_stores_keep_their_slashes() -> None:
    line = next_steps.next_line("extract", Path("s3://b/1.mcap"), "s3://b/2.mcap", "--rig", "dart", "--out", "d.zarr")
    assert command_of(line) == "extract s3://b/1.mcap s3://b/2.mcap --rig dart --out d.zarr"
