"""Command lines that reproduce settings."""

import shlex
from pathlib import Path

import tyro

from offpiste.cli.extract import Extract
from offpiste.core.command_line import command_line


def _parsed(line: str) -> Extract:
    program, name, *rest = shlex.split(line)
    assert (program, name) == ("offpiste", "extract")
    return tyro.cli(Extract, args=rest)


def test_the_same_settings_come_back() -> None:
    settings = Extract(("a log.mcap", "b.csv"), "my.toml", Path("data.zarr"), min_hindsight=0.25, force=True)
    line = command_line("extract", settings, "logs")
    assert line == "offpiste extract 'a log.mcap' b.csv --rig my.toml --out data.zarr --min-hindsight 0.25 --force"
    assert _parsed(line) == settings


def test_what_changes_is_named_even_where_it_is_the_default() -> None:
    settings = Extract(("drive.mcap",), "my.toml", Path("data.zarr"), split="fold:0/3")
    line = command_line("extract", settings, "logs", split="blocks:0.7,0.1,0.2", out=Path("data-2.zarr"))
    assert _parsed(line) == Extract(("drive.mcap",), "my.toml", Path("data-2.zarr"))
    assert "--split blocks:0.7,0.1,0.2" in line
