"""Runs the command line, or a script, with an extension from examples/extending in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

EXTENSIONS = Path(__file__).parents[2] / "examples" / "extending"


def offpiste(*arguments: str | Path, extension: str) -> "subprocess.CompletedProcess[str]":
    """The finished command; `extension` is the name of a module in examples/extending."""
    return python("-m", "offpiste", *arguments, extension=extension)


def python(*arguments: str | Path, extension: str) -> "subprocess.CompletedProcess[str]":
    """The finished interpreter, for scripts (`"-c", script, ...`)."""
    path = os.pathsep.join((str(EXTENSIONS), *filter(None, sys.path)))
    environment = os.environ | {"OFFPISTE_EXTENSIONS": extension, "PYTHONPATH": path, "COLUMNS": "100"}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
