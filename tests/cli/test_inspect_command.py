"""`offpiste inspect`: suggested next commands and written rigs."""

import errno
import os
import re
import shlex
from pathlib import Path

import pytest
from test_draft_tables import POSE, written

from cli.command import run
from offpiste.cli.entry import user_error_of
from offpiste.rig.rig import rig_text


@pytest.fixture
def log(tmp_path: Path) -> str:
    columns = {**POSE, "throttle": ("pedal", 1.0), "delta": ("angle", 1.0)}
    return str(written(tmp_path / "first drive.csv", columns))


def test_each_command_leads_to_the_next(log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    my, dataset = str(tmp_path / "my.toml"), str(tmp_path / "dataset.zarr")
    commands = [["inspect", log]]
    for expected in (["--write-rig", "my.toml"], ["--rig", my], ["--rig", my, "--out", "dataset.zarr"]):
        assert run(*commands[-1]) == 0
        following = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: "))
        assert following[0] == "offpiste"
        assert following[2:] == [log, *expected]
        commands.append([{"my.toml": my, "dataset.zarr": dataset}.get(word, word) for word in following[1:]])
    assert run(*commands[-1]) == 0
    assert Path(dataset).is_dir()


def test_warnings_lead_to_a_cured_rig_and_what_no_line_cures_is_to_be_mended(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("inspect", log, "--write-rig", "my.toml") == 0
    turned = Path("my.toml").read_text("utf-8").replace('fields = ["delta"]', 'fields = ["delta"]\nsign = -1')
    Path("my.toml").write_text(turned.replace("GUESSED", "measured"), "utf-8")
    capsys.readouterr()
    assert run("inspect", log, "--rig", "my.toml") == 0
    command = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next: "))
    assert command[2:] == [log, "--rig", "my.toml", "--write-rig", "my-2.toml"]
    assert run(*command[1:]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"next: offpiste inspect '{log}' --rig my-2.toml"

    without = tmp_path / "without.csv"  # no throttle
    without.write_text(Path(log).read_text("utf-8").replace("throttle", "battery"), "utf-8")
    run("inspect", str(without), "--write-rig", "other.toml")
    capsys.readouterr()
    assert run("inspect", str(without), "--rig", "other.toml") == 0
    vehicle, first, following = capsys.readouterr().out.splitlines()[-3:]
    assert vehicle.startswith("first: give other.toml the numbers of your vehicle")
    assert first == "first: fix what the warnings say, or leave it where the log has no better"
    assert following.startswith("next: offpiste extract")


def test_a_preset_of_another_vehicle_leads_to_a_first_rig(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("inspect", log, "--rig", "tartandrive2") == 1
    assert capsys.readouterr().out.splitlines()[-1] == f"next: offpiste inspect '{log}' --write-rig my.toml"


def test_without_a_pose_the_next_step_is_one_that_works(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = Path(log).read_text("utf-8")
    for name, header, next_step in (
        ("nameless.csv", "t,a,b,c", "next: offpiste inspect nameless.csv --rig my.toml"),
        ("comma.csv", "t,ecef_x,ecef_y,ecef_z", "next: offpiste inspect comma.csv"),
    ):
        Path(name).write_text(text.replace("t,x,y,yaw", header), "utf-8")
        assert run("inspect", name) == 1
        first, following = capsys.readouterr().out.splitlines()[-2:]
        assert first.startswith("first: ")
        assert following == next_step


def test_a_time_that_no_name_shows_is_named(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    header, *rows = Path(log).read_text("utf-8").splitlines()
    assert header.startswith("t,")
    kept = [row for number, row in enumerate(rows) if number % 7 not in (2, 3, 5)]
    Path("odd.csv").write_text("\n".join([f"moment{header[1:]}", *kept]) + "\n", "utf-8")
    assert run("inspect", "odd.csv") == 1
    assert "no column looks like time; name it: `inspect --time COLUMN`" in capsys.readouterr().err
    assert run("inspect", "odd.csv", "--time", "moment") == 0
    following = capsys.readouterr().out.splitlines()[-1]
    assert following == "next: offpiste inspect odd.csv --time moment --write-rig my.toml"
    assert run(*shlex.split(following)[2:]) == 0
    assert 'column = "moment"' in Path("my.toml").read_text("utf-8")
    assert run("inspect", "odd.csv", "--rig", "my.toml") == 0
    capsys.readouterr()
    assert run("inspect", "odd.csv", "--time", "moment", "--rig", "my.toml") == 1
    assert "--time is for one log without a rig" in capsys.readouterr().err


def test_a_column_that_cannot_be_read_is_said_to_be_and_not_to_be_missing(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = Path(log).read_text("utf-8").splitlines()
    at = lines[0].split(",").index("delta")
    cells = lines[200].split(",")
    lines[200] = ",".join([*cells[:at], "bad", *cells[at + 1 :]])
    Path("bad.csv").write_text("\n".join(lines) + "\n", "utf-8")
    run("inspect", "bad.csv", "--write-rig", "my.toml")
    printed = capsys.readouterr()
    why = "row 200 below the header, column 'delta': 'bad' is not a number"
    assert f"missing: steering: {why}; no model can do without" in " ".join(printed.err.split())
    said = " ".join(printed.out.split())
    assert said.count(why) == 1
    assert "nothing reads delta" not in said
    assert "no field looks like it" not in printed.err


def test_a_given_rig_is_written_with_its_comments(log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new = tmp_path / "old.toml", tmp_path / "new.toml"
    run("inspect", log, "--write-rig", str(old))
    old.write_text("# ours\n" + old.read_text("utf-8"), "utf-8")
    assert run("inspect", log, "--rig", str(old), "--write-rig", str(new)) == 0
    assert new.read_text("utf-8") == old.read_text("utf-8")
    assert capsys.readouterr().out.splitlines()[-1].endswith(f"--rig {new} --out dataset.zarr")  # nothing to cure
    assert run("inspect", log, "--rig", str(old), "--write-rig", str(new)) == 1
    assert "already exists" in capsys.readouterr().err
    assert rig_text("dart").startswith("# DART")


def test_a_folder_of_logs_is_inspected_log_by_log(log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "drive 0.csv").write_bytes(Path(log).read_bytes())
    (tmp_path / "notes.pdf").touch()
    assert run("inspect", str(tmp_path)) == 0
    said = capsys.readouterr()
    assert [f"{name}  " in said.out for name in ("drive 0", "first drive")] == [True, True]
    assert said.out.splitlines()[-1].startswith(f"next: offpiste inspect '{tmp_path / 'drive 0.csv'}'")
    assert said.err == f"ignored in {tmp_path}: notes.pdf\n"
    for number in range(1, 6):
        (tmp_path / f"drive {number}.csv").touch()
    assert run("extract", str(tmp_path), "--rig", "dart", "--out", str(tmp_path / "d.zarr")) == 1
    error = capsys.readouterr().err
    assert "a folder of logs: drive 0.csv, drive 1.csv" in error
    assert "and 2 more" in error
    assert error.rstrip().endswith(f"offpiste inspect {shlex.quote(str(tmp_path))}")


def test_an_extraction_with_another_rig_gets_another_name(
    log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run("inspect", log, "--write-rig", "my.toml")
    (drafted,) = re.findall("mass = ([0-9.]+)", Path("my.toml").read_text("utf-8"))
    run("extract", log, "--rig", "my.toml", "--out", "dataset.zarr")
    proposed = []
    for mass in (drafted, "901.0"):
        Path("my.toml").write_text(
            re.sub("mass = [0-9.]+", f"mass = {mass}", Path("my.toml").read_text("utf-8")), "utf-8"
        )
        capsys.readouterr()
        run("inspect", log, "--rig", "my.toml")
        proposed.append(shlex.split(capsys.readouterr().out.splitlines()[-1])[-1])
    assert proposed == ["dataset.zarr", "dataset-2.zarr"]


def test_findings_are_shown_although_no_rig_can_be_drafted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "no pose.csv"
    file.write_text("time,a\n" + "".join(f"{0.02 * row:.2f},{row % 7}\n" for row in range(600)))
    assert run("inspect", str(file), "--write-rig", str(tmp_path / "my.toml")) == 1
    said = capsys.readouterr()
    assert "600" in said.out, "the table of topics"
    assert said.err.startswith("offpiste: ")
    assert not (tmp_path / "my.toml").exists()


def test_errors_of_the_operating_system_are_one_line() -> None:
    for number, said in (
        (errno.EACCES, "my.toml: cannot be opened: Permission denied; give readable files"),
        (errno.EROFS, "my.toml: cannot be opened: Read-only file system"),
        (errno.ENOSPC, "my.toml: cannot be written: No space left on device; make room"),
        (errno.ENOTDIR, "my.toml: is a file, or is inside one"),
        (errno.EISDIR, "my.toml: cannot be used: Is a directory; give another path"),
        (errno.EIO, "my.toml: cannot be used: Input/output error; give another path"),
    ):
        assert str(user_error_of(OSError(number, os.strerror(number), "my.toml"))).startswith(said)
    assert user_error_of(OSError(errno.EIO, "no device")) is None
