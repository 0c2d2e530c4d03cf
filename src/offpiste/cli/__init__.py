"""Command-line interface: one subcommand per stage, no logic."""

from offpiste.cli.entry import main

__all__ = ["main"]
