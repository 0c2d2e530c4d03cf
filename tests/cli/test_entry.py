"""Commands on a small simulated log: exit codes, messages, files."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import offpiste
from cli.command import refusal, run
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings

RIG = ("--rig", "proving_ground")


QUICK = ("--epochs", "1", "--bicycle-epochs", "1", "--actuator-epochs", "1", "--stride", "100")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated drive, extracted and trained on: what the commands read."""
    folder = tmp_path_factory.mktemp("cli")
    world = WorldSettings("uniform", size=150.0, resolution=0.5)
    assert simulate(DriveSettings(world, 120.0, seed=1, sensors="none"), folder / "drive.mcap").seconds == 120.0
    assert run("extract", folder / "drive.mcap", *RIG, "--out", folder / "dataset.zarr") == 0
    assert run("train", folder / "dataset.zarr", "--out", folder / "b", *QUICK) == 0
    return folder


def test_train_ends_with_the_next_command(folder, capsys):
    dataset, out = folder / "dataset.zarr", folder / "b"
    assert run("train", dataset, "--out", out, *QUICK, "--resume") == 0
    assert capsys.readouterr().out.endswith(f"next: offpiste evaluate {out} --dataset {dataset}\n")


def test_a_training_that_has_not_converged_says_how_to_go_on(folder, capsys, tmp_path, monkeypatch):
    dataset, out = folder / "dataset.zarr", tmp_path / "physics"
    quick = [*QUICK, "--model", "parametric", "--epochs", "2", "--constants-learning-rate", "1e-3", "--seed", "3"]
    assert run("train", dataset, "--out", out, *quick) == 0
    said = capsys.readouterr().out
    assert "parametric has no bicycle stage: --bicycle-epochs has no effect, --epochs has" in said
    (line,) = (line for line in said.splitlines() if line.startswith("not converged yet: train again with "))
    assert line.endswith(f"--epochs 4 --out {out}-longer")
    assert run("train", dataset, "--out", tmp_path / "b", *QUICK) == 0
    compared = capsys.readouterr().out.splitlines()[-1]
    assert compared.startswith(f"next: offpiste evaluate {tmp_path / 'b'} {out} --dataset {dataset}")
    monkeypatch.chdir(tmp_path)
    assert run(*shlex.split(compared)[2:]) == 0


def test_evaluate_writes_report_and_metrics(folder, capsys):
    report = folder / "report"
    report.mkdir()
    for name in (".offpiste-report", "growth.png"):  # of an evaluation that was killed
        (report / name).touch()
    (report / "metrics.json").write_text('{"dataset": "other.zarr", "results": [{"model": "dc"}, {"model": "dc"}]}')
    assert run("evaluate", folder / "b", "--dataset", folder / "dataset.zarr", "--out", report) == 0
    metrics = json.loads((report / "metrics.json").read_text())
    assert metrics["schema"] == 2
    assert {row["model"] for row in metrics["results"]} == {"b", "ctrv", "kinematic"}
    assert {row["start"] for row in metrics["results"]} == {"causal", "smoothed"}
    assert (report / "report.html").stat().st_size > 10_000
    assert not (report / ".offpiste-report").exists()
    message = capsys.readouterr().out
    assert f"warning: replacing the report of dc on other.zarr in {report}\n" in message
    assert "kinematic" in message
    assert message.splitlines()[-1] == f"next: offpiste calibrate {folder / 'b'} --dataset {folder / 'dataset.zarr'}"
    assert ("–: no interval" in message) == (metrics["windows"]["blocks"] < 3)


def test_inspect_prints_json_and_exits_with_1_where_a_log_is_unusable(folder, capsys, tmp_path):
    assert run("inspect", folder / "drive.mcap", *RIG, "--json") == 0
    assert json.loads(capsys.readouterr().out)["usable"] is True
    (tmp_path / "still.csv").write_text("time,x,y\n" + "".join(f"{i / 50},0,0\n" for i in range(500)))
    assert run("inspect", tmp_path / "still.csv") == 1


def test_extract_resumes_where_it_stopped(folder, capsys):
    assert run("extract", folder / "drive.mcap", *RIG, "--out", folder / "dataset.zarr") == 0
    assert "drive: already there" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("inspect", "nothing.mcap"), "nothing.mcap: no such file or folder"),
        (("extract", "{drive}", "{drive}", *RIG, "--out", "{tmp}/d.zarr"), "two logs are called 'drive'"),
        (("extract", "{drive}", *RIG, "--out", "{dataset}", "--flat"), "another rig"),
        (("train", "{tmp}/nothing.zarr", "--out", "{tmp}/run"), "not a dataset"),
        (("train", "{dataset}", "--out", "{run}"), "holds a run that was begun with other settings"),
        (("train", "{dataset}", "--out", "{tmp}/run", "--device", "abacus"), "no device 'abacus'"),
        (("train", "{dataset}", "--out", "{tmp}/run", "--seed", "99999999999999999999"), "below 2^63"),
        (
            ("extract", "{drive}", *RIG, "--out", "{tmp}/d.zarr", "--keyframe-metres", "nan"),
            "invalid --keyframe-metres nan",
        ),
        (("fit-pca", "{drive}", "--rig", "kitti", "--images", "0"), "invalid --images 0; give 1 or more"),
        (("fit-pca", "{drive}", "--rig", "kitti", "--out", "{dataset}"), "is a folder; give a file as --out"),
        (("inspect", "{drive}", "--write-rig", "{dataset}/zarr.json"), "already exists"),
        (("extract", *RIG, "--out", "{tmp}/d.zarr"), "no log is given"),
        (("fit-pca", "--rig", "kitti"), "the log is missing"),
        (("check",), "nothing to check"),
        (("evaluate", "--dataset", "{dataset}"), "the runs are missing"),
        (("evaluate", "{run}b", "--dataset", "{dataset}"), "no such folder; did you mean '{run}'?"),
        *(
            ((*words, "--out", "{run}/model.json/more"), "is a file")
            for words in (("evaluate", "{run}", "--dataset", "{dataset}"), ("train", "{dataset}"), ("demo",))
        ),
    ],
)
def test_a_mistake_ends_in_one_line_and_exit_code_1(folder, tmp_path, capsys, arguments, message):
    places = {
        "tmp": tmp_path, "drive": folder / "drive.mcap", "dataset": folder / "dataset.zarr", "run": folder / "b",
    }  # fmt: skip
    line = refusal(capsys, *(argument.format(**places) for argument in arguments))
    assert message.format(**places) in line


def test_the_version_is_that_of_the_package(capsys):
    assert run("--version") == 0
    assert capsys.readouterr().out == f"offpiste {offpiste.__version__}\n"


@pytest.mark.parametrize(("word", "meant"), [("fly", "Commands"), ("tr\nain", "did you mean 'train'? C")])
def test_an_unknown_command_is_one_line_with_a_suggestion(capsys, word, meant):
    assert run(word, "--out", "x") == 2
    error = capsys.readouterr().err
    assert error.startswith("offpiste: unknown command '")
    assert f"; {meant}" in error
    assert "Commands: demo, simulate, inspect" in error
    assert error.count("\n") == 1


def test_a_pipe_that_is_closed_early_is_no_error():
    command = f"{sys.executable} -c 'from offpiste.cli import main; main()' train --help | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=120)
    assert done.stdout.startswith("usage")
    assert not done.stderr


def test_wrong_usage_shows_options_of_its_command_alone(capsys):
    assert run("train") == 2
    assert run("demo", "--seedd", "3") == 2
    message = capsys.readouterr().err
    assert "--seed INT" in message
    assert "offpiste simulate" not in message
