"""Command lines that reproduce settings."""

from pathlib import Path

import tyro

from offpiste.cli.extract import Extract
from offpiste.core.command_line import options


def test_the_same_settings_come_back_and_what_changes_is_named_even_where_it_is_the_default() -> None:
    settings = Extract(("a log.mcap",), "my.toml", Path("data.zarr"), split="fold:0/3", min_hindsight=0.25, force=True)
    words = options(settings, "logs")
    assert " ".join(words) == "--rig my.toml --out data.zarr --split fold:0/3 --min-hindsight 0.25 --force"
    assert tyro.cli(Extract, args=["a log.mcap", *words]) == settings
    assert "--split blocks:0.7,0.1,0.2" in " ".join(options(settings, "logs", split="blocks:0.7,0.1,0.2"))
