"""Output folders of commands, interrupted commands, and suggested next ones."""

import shlex
import shutil
from pathlib import Path
from unittest.mock import Mock

import pytest

from cli.command import refusal, run
from feature_datasets import dataset_with_features
from offpiste.cli import entry, next_steps
from offpiste.cli.entry import COMMANDS, commands_in_order, parse
from offpiste.cli.extract import Extract
from offpiste.cli.view import View
from offpiste.core.errors import OffpisteError
from offpiste.core.files import check_folder, unfinished
from offpiste.core.shipped import run_folder
from offpiste.dataset.store import Dataset
from offpiste.training.checkpoint import load_json, save_json
from offpiste.uncertainty.fit import FILE

B = Path("pretrained:proving-ground/b")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("dataset") / "data.zarr", rows=4000)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        ("demo", "--out", "{out}"),
        ("evaluate", str(B), "--dataset", "{data}", "--out", "{out}"),
        ("calibrate", str(B), "--dataset", "{data}", "--out", "{out}"),
        ("train", "{data}", "--model", "b", "--out", "{out}"),
        ("extract", "drive.csv", "--rig", "proving_ground", "--out", "{out}"),
        ("drive", str(B), "--out", "{out}"),
        ("simulate", "--drives", "2", "--out", "{out}"),
        ("reproduce", "fig4", "--out", "{out}"),
        ("export", str(B), "--to", "{out}"),
        ("view", "{data}", "--out", "{out}"),
        ("merge", "{data}", "{data}", "--out", "{out}"),
    ],
    ids=lambda words: words[0],
)
def test_a_folder_with_other_files_is_refused_and_left_alone(words, dataset, tmp_path, capsys):
    (tmp_path / "drive.csv").write_text("t,x\n0,1\n")
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.png").write_text("mine")
    assert refusal(capsys, *(word.format(out=out, data=dataset.path) for word in words))
    assert [path.name for path in out.iterdir()] == ["mine.png"]


def test_a_folder_that_was_not_written_whole_is_written_again(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(FileNotFoundError), unfinished(out, ".mark"):
        (out / "half.png").rename(out / "whole.png")
    (out / "half.png").touch()
    check_folder(out, own=(".mark",))
    with unfinished(out, ".mark"):
        pass
    with pytest.raises(OffpisteError, match="contains other files"):
        check_folder(out, own=(".mark",))


def test_demo_leaves_a_folder_of_runs_alone(tmp_path, capsys):
    inside = tmp_path / "out" / "dc"
    inside.mkdir(parents=True)
    for name in ("model.json", "pca.safetensors"):
        (inside / name).write_text("mine")
    assert "contains other files" in refusal(capsys, "demo", "--out", tmp_path / "out")
    assert {path.name for path in inside.iterdir()} == {"model.json", "pca.safetensors"}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("extract", "resume: offpiste extract 'my drive.mcap' --out d.zarr"),
        ("train", "resume: offpiste train 'my drive.mcap' --out d.zarr --resume"),
        ("evaluate", "run it again: offpiste evaluate 'my drive.mcap' --out d.zarr"),
    ],
)
def test_an_interrupted_command_names_the_one_that_goes_on(name, said, monkeypatch, capsys):
    monkeypatch.setattr(entry, "parse", Mock(return_value=Mock(run=Mock(side_effect=KeyboardInterrupt))))
    assert run(name, "my drive.mcap", "--out", "d.zarr") == 1
    assert said in capsys.readouterr().err


def test_commands_that_resume_exist():
    assert set(entry.RESUMABLE) <= set(COMMANDS)


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


def test_an_evaluation_leads_to_a_calibration_only_where_that_is_possible():
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


def test_runs_that_cannot_be_exported_lead_to_one_that_can(monkeypatch):
    ready = trained(Path("runs/ready"), spread=True)
    monkeypatch.setattr("offpiste.dynamics.kernels.coverage.uncovered", lambda dynamics: "another network")
    assert command_of(next_steps.after_runs([ready], Path("d.zarr"))) == "train d.zarr --model b --out runs/b"


def test_a_shard_leads_to_the_merge_of_all(dataset):
    options = Extract(("a.csv",), "dart", Path("part-1.zarr"), shard="1/2")
    merge = "merge part-1.zarr ... --out dataset.zarr"
    assert command_of(next_steps.after_extraction(options, dataset)) == merge


def test_a_dataset_leads_to_the_same_training_after_merge_and_view(dataset):
    viewed = next_steps.after_view(View(dataset.path, rig="dart"))
    for line in (next_steps.after_dataset(dataset, dataset.path), viewed):
        model = "dc" if dataset.pca else "parametric"
        assert command_of(line) == f"train {dataset.path} --model {model} --out runs/{model}"
    assert command_of(next_steps.after_view(View(dataset.path, run_folder=B))).startswith(f"drive {B}")


def test_a_viewed_log_leads_to_its_extraction():
    line = next_steps.after_view(View(Path("drive.mcap"), rig="dart", pca=Path("pca.safetensors")))
    assert command_of(line) == "extract drive.mcap --rig dart --pca pca.safetensors --out dataset.zarr"


def test_places_in_object_stores_keep_their_slashes():
    line = next_steps.next_line("extract", Path("s3://b/1.mcap"), "s3://b/2.mcap", "--rig", "dart", "--out", "d.zarr")
    assert command_of(line) == "extract s3://b/1.mcap s3://b/2.mcap --rig dart --out d.zarr"
