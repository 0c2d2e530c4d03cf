"""Programs of offpiste beside each other: a simulator or a player, and `live`."""

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from offpiste.errors import LiveError

_ENDS: Final = 30.0
"""A program that does not end within so long after Ctrl-C is killed [s]."""


@contextmanager
def started(arguments: Sequence[str], said: Path) -> Iterator["subprocess.Popen[str]"]:
    """`offpiste ARGUMENTS` as a process, which is ended as by Ctrl-C.

    Args:
        said: file of what it says.

    Raises:
        LiveError: it cannot be started.
    """
    try:
        with said.open("w") as file:
            command = [sys.executable, "-m", "offpiste", *arguments]
            program = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, text=True)
    except OSError as error:
        raise LiveError(f"cannot be started: {error}", where=said) from error
    try:
        yield program
    finally:
        if program.poll() is None:
            program.send_signal(signal.SIGINT)
        try:
            program.wait(_ENDS)
        except subprocess.TimeoutExpired:
            program.kill()
