"""Output folders of commands, and interrupted commands."""

from pathlib import Path
from unittest.mock import Mock

import pytest

from cli.command import refusal, run
from feature_datasets import dataset_with_features
from offpiste.cli import entry
from offpiste.cli.entry import COMMANDS
from offpiste.core.errors import OffpisteError
from offpiste.core.files import check_folder, unfinished


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dataset_with_features(tmp_path_factory.mktemp("dataset") / "data.zarr").path


B = "pretrained:proving-ground/b"


@pytest.mark.parametrize(
    "words",
    [
        ("demo", "--out", "{out}"),
        ("evaluate", B, "--dataset", "{data}", "--out", "{out}"),
        ("calibrate", B, "--dataset", "{data}", "--out", "{out}"),
        ("train", "{data}", "--model", "b", "--out", "{out}"),
        ("extract", "drive.csv", "--rig", "proving_ground", "--out", "{out}"),
        ("drive", B, "--out", "{out}"),
        ("simulate", "--drives", "2", "--out", "{out}"),
        ("reproduce", "fig4", "--out", "{out}"),
        ("export", B, "--to", "{out}"),
        ("view", "{data}", "--out", "{out}"),
        ("merge", "{data}", "{data}", "--out", "{out}"),
    ],
    ids=lambda words: words[0],
)
def test_a_folder_with_other_files_is_refused_and_left_alone(words, dataset, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.csv").write_text("t,x\n0,1\n")
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.png").write_text("mine")
    assert refusal(capsys, *(word.format(out=out, data=dataset) for word in words))
    assert [path.name for path in out.iterdir()] == ["mine.png"]


def test_a_folder_that_was_not_written_whole_is_written_again(dataset, tmp_path):
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
