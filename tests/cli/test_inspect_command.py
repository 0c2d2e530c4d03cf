"""`offpiste inspect`: suggested next commands and written rigs."""

import errno
import os
import re
import shlex
from pathlib import Path

import pytest
from test_draft_tables import POSE, written

from cli.command import refusal, run
from offpiste.cli.entry import user_error_of
from offpiste.rig.rig import rig_text

LOG = "first drive.csv"


@pytest.fixture(autouse=True)
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A log in the current folder."""
    monkeypatch.chdir(tmp_path)
    written(tmp_path / LOG, {**POSE, "throttle": ("pedal", 1.0), "delta": ("angle", 1.0)})
    return Path(LOG).read_text("utf-8")


def said(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> list[str]:
    """Output lines of a command that ends with a code."""
    capsys.readouterr()
    assert run(*words) == code
    return capsys.readouterr().out.splitlines()


def edit(file: str | Path, old: str, new: str) -> None:
    Path(file).write_text(re.sub(old, new, Path(file).read_text("utf-8")), "utf-8")


def test_each_command_leads_to_the_next(capsys):
    words = ["inspect", LOG]
    for expected in (["--write-rig", "my.toml"], ["--rig", "my.toml"], ["--rig", "my.toml", "--out", "dataset.zarr"]):
        line = said(capsys, *words)[-1]
        assert line.startswith("next: offpiste ")
        words = shlex.split(line)[2:]
        assert words[1:] == [LOG, *expected]
    assert run(*words) == 0
    assert Path("dataset.zarr").is_dir()


def test_warnings_lead_to_a_cured_rig_and_what_no_line_cures_is_to_be_mended(log, capsys):
    run("inspect", LOG, "--write-rig", "my.toml")
    edit("my.toml", r'fields = \["delta"\]', 'fields = ["delta"]\nsign = -1')
    edit("my.toml", "GUESSED", "measured")
    following = said(capsys, "inspect", LOG, "--rig", "my.toml")[-1]
    assert following == f"next: offpiste inspect '{LOG}' --rig my.toml --write-rig my-2.toml"
    assert said(capsys, *shlex.split(following)[2:])[-1] == f"next: offpiste inspect '{LOG}' --rig my-2.toml"

    Path("without.csv").write_text(log.replace("throttle", "battery"), "utf-8")
    run("inspect", "without.csv", "--write-rig", "other.toml")
    vehicle, first, following = said(capsys, "inspect", "without.csv", "--rig", "other.toml")[-3:]
    assert vehicle.startswith("first: give other.toml the numbers of your vehicle")
    assert first == "first: fix what the warnings say, or leave it where the log has no better"
    assert following.startswith("next: offpiste extract")


def test_a_preset_of_another_vehicle_leads_to_a_first_rig(capsys):
    following = said(capsys, "inspect", LOG, "--rig", "tartandrive2", code=1)[-1]
    assert following == f"next: offpiste inspect '{LOG}' --write-rig my.toml"


@pytest.mark.parametrize(("header", "more"), [("t,a,b,c", " --rig my.toml"), ("t,ecef_x,ecef_y,ecef_z", "")])
def test_without_a_pose_the_next_step_is_one_that_works(log, capsys, header, more):
    Path("other.csv").write_text(log.replace("t,x,y,yaw", header), "utf-8")
    first, following = said(capsys, "inspect", "other.csv", code=1)[-2:]
    assert first.startswith("first: ")
    assert following == f"next: offpiste inspect other.csv{more}"


def test_a_time_that_no_name_shows_is_named(log, capsys):
    header, *rows = log.splitlines()
    assert header.startswith("t,")
    kept = [row for number, row in enumerate(rows) if number % 7 not in (2, 3, 5)]
    Path("odd.csv").write_text("\n".join([f"moment{header[1:]}", *kept]) + "\n", "utf-8")
    assert run("inspect", "odd.csv") == 1
    assert "no column looks like time; name it: `inspect --time COLUMN`" in capsys.readouterr().err
    following = said(capsys, "inspect", "odd.csv", "--time", "moment")[-1]
    assert following == "next: offpiste inspect odd.csv --time moment --write-rig my.toml"
    assert run(*shlex.split(following)[2:]) == 0
    assert 'column = "moment"' in Path("my.toml").read_text("utf-8")
    assert run("inspect", "odd.csv", "--rig", "my.toml") == 0
    capsys.readouterr()
    for option in ("--time", "--namespace"):
        why = refusal(capsys, "inspect", "odd.csv", option, "moment", "--rig", "my.toml")
        assert f"{option} is for a log without a rig" in why


def test_a_column_that_cannot_be_read_is_said_to_be_and_not_to_be_missing(log, capsys):
    lines = log.splitlines()
    at = lines[0].split(",").index("delta")
    cells = lines[200].split(",")
    lines[200] = ",".join([*cells[:at], "bad", *cells[at + 1 :]])
    Path("bad.csv").write_text("\n".join(lines) + "\n", "utf-8")
    run("inspect", "bad.csv", "--write-rig", "my.toml")
    printed = capsys.readouterr()
    why = "row 200 below the header, column 'delta': 'bad' is not a number"
    assert f"missing: steering: {why}; no model can do without" in " ".join(printed.err.split())
    output = " ".join(printed.out.split())
    assert output.count(why) == 1
    assert "nothing reads delta" not in output
    assert "no field looks like it" not in printed.err


def test_a_given_rig_is_written_with_its_comments(capsys):
    run("inspect", LOG, "--write-rig", "old.toml")
    edit("old.toml", r"\A", "# ours\n")
    again = ("inspect", LOG, "--rig", "old.toml", "--write-rig", "new.toml")
    assert said(capsys, *again)[-1].endswith("--rig new.toml --out dataset.zarr")  # nothing to cure
    assert Path("new.toml").read_text("utf-8") == Path("old.toml").read_text("utf-8")
    assert run(*again) == 1
    assert "already exists" in capsys.readouterr().err
    assert rig_text("dart").startswith("# DART")


def test_a_folder_of_logs_is_inspected_log_by_log(log, tmp_path, capsys):
    Path("drive 0.csv").write_text(log, "utf-8")
    Path("notes.pdf").touch()
    assert run("inspect", tmp_path) == 0
    printed = capsys.readouterr()
    assert [f"{name}  " in printed.out for name in ("drive 0", "first drive")] == [True, True]
    assert printed.out.splitlines()[-1].startswith(f"next: offpiste inspect '{tmp_path / 'drive 0.csv'}'")
    assert printed.err == f"ignored in {tmp_path}: notes.pdf\n"
    for number in range(1, 6):
        Path(f"drive {number}.csv").touch()
    error = refusal(capsys, "extract", tmp_path, "--rig", "dart", "--out", "d.zarr")
    assert "a folder of logs: drive 0.csv, drive 1.csv" in error
    assert "and 2 more" in error
    assert error.endswith(f"offpiste inspect {shlex.quote(str(tmp_path))}")


def test_an_extraction_with_another_rig_gets_another_name(capsys):
    run("inspect", LOG, "--write-rig", "my.toml")
    run("extract", LOG, "--rig", "my.toml", "--out", "dataset.zarr")
    for mass, proposed in ((r"\g<0>", "dataset.zarr"), ("mass = 901.0", "dataset-2.zarr")):
        edit("my.toml", "mass = [0-9.]+", mass)
        assert said(capsys, "inspect", LOG, "--rig", "my.toml")[-1].endswith(f"--out {proposed}")


def test_findings_are_shown_although_no_rig_can_be_drafted(capsys):
    Path("no pose.csv").write_text("time,a\n" + "".join(f"{0.02 * row:.2f},{row % 7}\n" for row in range(600)))
    assert run("inspect", "no pose.csv", "--write-rig", "my.toml") == 1
    printed = capsys.readouterr()
    assert "600" in printed.out, "the table of topics"
    assert printed.err.startswith("offpiste: ")
    assert not Path("my.toml").exists()


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (errno.EACCES, "my.toml: cannot be opened: Permission denied; give readable files"),
        (errno.EROFS, "my.toml: cannot be opened: Read-only file system"),
        (errno.ENOSPC, "my.toml: cannot be written: No space left on device; make room"),
        (errno.ENOTDIR, "my.toml: is a file, or is inside one"),
        (errno.EISDIR, "my.toml: cannot be used: Is a directory; give another path"),
        (errno.EIO, "my.toml: cannot be used: Input/output error; give another path"),
    ],
)
def test_errors_of_the_operating_system_are_one_line(number, message):
    assert str(user_error_of(OSError(number, os.strerror(number), "my.toml"))).startswith(message)
    assert user_error_of(OSError(errno.EIO, "no device")) is None
