"""The command line: one subcommand a stage, no logic."""

from offpiste.cli.entry import main

__all__ = ["main"]
