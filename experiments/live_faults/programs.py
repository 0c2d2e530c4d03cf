"""Programs of offpiste beside each other: a simulator or a player, and `live`."""

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from offpiste.core.errors import LiveError

_ENDS: Final = 30.0
"""A program that does not end within so long after Ctrl-C is killed [s]."""


def begun(arguments: Sequence[str], said: Path) -> "subprocess.Popen[str]":
    """`offpiste ARGUMENTS` as a process.

    Args:
        said: file of what it says.

    Raises:
        LiveError: it cannot be started.
    """
    try:
        with said.open("w") as file:
            command = [sys.executable, "-m", "offpiste", *arguments]
            return subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, text=True)
    except OSError as error:
        raise LiveError(f"cannot be started: {error}", where=said) from error


def ended(*programs: "subprocess.Popen[str]") -> None:
    """End programs as Ctrl-C does, all at once; those that do not end are killed."""
    for program in programs:
        if program.poll() is None:
            program.send_signal(signal.SIGINT)
    for program in programs:
        try:
            program.wait(_ENDS)
        except subprocess.TimeoutExpired:
            program.kill()


@contextmanager
def started(arguments: Sequence[str], said: Path) -> Iterator["subprocess.Popen[str]"]:
    """`offpiste ARGUMENTS` as a process that ends with the context (`begun`, `ended`)."""
    program = begun(arguments, said)
    try:
        yield program
    finally:
        ended(program)
