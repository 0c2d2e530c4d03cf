"""A command of an extension."""

from pathlib import Path

from extending.outside import offpiste


def test_a_command_of_an_extension_runs_and_stands_in_the_help(tmp_path: Path) -> None:
    log = tmp_path / "drive.csv"
    log.write_text("time,x,y\n" + "".join(f"{i / 50},{i},0\n" for i in range(101)))
    done = offpiste("digest", log, extension="digest")
    assert done.returncode == 0, done.stderr
    seconds, digest, name = done.stdout.split("  ")
    assert (seconds, name.strip()) == ("2.0 s", str(log))

    log.write_text(log.read_text().replace("7,0", "7,1"))
    assert offpiste("digest", log, extension="digest").stdout.split("  ")[1] != digest

    listed = "".join(offpiste("--help", extension="digest").stdout.replace("│", "").split())
    assert "merge,digest}" in listed, "commands that ship come first"
    assert "tellcopiesfromlook-alikes" in listed


def test_mistakes_of_a_command_of_an_extension_are_one_line_too(tmp_path: Path) -> None:
    done = offpiste("digest", tmp_path / "nothing.csv", extension="digest")
    assert done.returncode == 1
    assert done.stderr == f"offpiste: {tmp_path / 'nothing.csv'}: no such file or folder\n"


def test_an_extension_that_is_not_there_is_named() -> None:
    done = offpiste("--help", extension="no_such_extension")
    assert done.returncode == 1
    assert done.stderr.startswith("offpiste: OFFPISTE_EXTENSIONS: cannot import 'no_such_extension'")
    assert done.stderr.count("\n") == 1
