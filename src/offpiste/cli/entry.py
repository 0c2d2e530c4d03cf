"""Entry point of the command line: parsing of arguments, errors, exit codes."""

import atexit
import errno
import gc
import os
import sys
from collections.abc import Callable, Sequence
from shlex import join
from typing import Final, Protocol, runtime_checkable

import tyro

from offpiste._version import __version__
from offpiste.core.errors import OffpisteError, did_you_mean
from offpiste.core.progress import log_to_terminal
from offpiste.core.registry import Registry


@runtime_checkable
class Command(Protocol):
    """Dataclass whose fields are arguments; tyro makes the help from its docstrings."""

    def run(self) -> int:
        """Run the command and return its exit code: 0 for success, 1 for unsuitable input."""


COMMANDS: Final[Registry[Callable[..., Command]]] = Registry("command", package=__package__)

PIPELINE: Final = (
    "demo",
    "simulate",
    "inspect",
    "view",
    "fit-pca",
    "extract",
    "train",
    "evaluate",
    "calibrate",
    "reproduce",
    "drive",
    "doctor",
    "live",
    "play",
    "export",
    "check",
)
"""Order of commands in the help; others follow."""

LIBRARIES: Final = {
    "OPENCV_LOG_LEVEL": "SILENT",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
}
"""Environment variables that libraries read on import. OpenCV's messages would repeat our errors, BLAS threads would
spin beside ours, and waiting OpenMP threads would take time from other processes."""

_NO_ROOM: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NO_FOLDER: Final = {errno.EEXIST, errno.ENOTDIR}
_NOT_ALLOWED: Final = {errno.EACCES, errno.EPERM, errno.EROFS}
_MAKE_ROOM: Final = "make room on the disk and run it again; finished results are kept"


def commands_in_order() -> dict[str, Callable[..., Command]]:
    """Return all commands by name, in the order of `PIPELINE`."""
    order = {name: number for number, name in enumerate(PIPELINE)}
    return dict(sorted(COMMANDS.items(), key=lambda named: order.get(named[0], len(order))))


def user_error_of(error: OSError) -> OffpisteError | None:
    """Return the error for users of an error of the operating system; None if it names no file."""
    where = error.filename or "a file"
    if error.errno in _NO_FOLDER:
        return OffpisteError("is a file, or is inside one", where=where, how="give a folder as --out")
    if error.errno in _NO_ROOM:
        return OffpisteError(f"cannot be written: {error.strerror}", where=where, how=_MAKE_ROOM)
    if error.errno in _NOT_ALLOWED:
        how = "give readable files and writable folders"
        return OffpisteError(f"cannot be opened: {error.strerror}", where=where, how=how)
    if error.filename:
        return OffpisteError(f"cannot be used: {error.strerror}", where=where, how="give another path, or repair it")
    return None


def _no_command(word: str, commands: Sequence[str]) -> OffpisteError:
    """Return the error for an unknown command."""
    how = f"{did_you_mean(word, commands)}Commands: {', '.join(commands)}"
    return OffpisteError(f"unknown command '{word}'", how=how)


def _parsed(arguments: list[str], commands: dict[str, Callable[..., Command]]) -> Command:
    """Parse arguments to a command; prints and exits on wrong usage or `--help`."""
    config = (tyro.conf.FlagCreatePairsOff,)
    if arguments and arguments[0] in commands:
        # Parsing one command alone is faster, and errors suggest no options of others.
        name, *rest = arguments
        return tyro.cli(commands[name], prog=f"offpiste {name}", args=rest, config=config)
    about = (
        "Dynamics models of off-road vehicles that see the terrain ahead."
        " --version prints the version; --debug shows tracebacks."
    )
    return tyro.extras.subcommand_cli_from_dict(
        commands, prog="offpiste", description=about, args=arguments, config=config
    )


RESUMING: Final = {
    "demo": (), "extract": (), "merge": (), "reproduce": (), "simulate": (), "train": ("--resume",),
}  # fmt: skip
"""Commands that can be resumed, with the required option."""


def _again(arguments: Sequence[str]) -> str:
    """Return the command line that continues an interrupted command."""
    name = arguments[0] if arguments else ""
    more = [each for each in RESUMING.get(name, ()) if each not in arguments]
    command = join(["offpiste", *arguments, *more])
    if name in RESUMING:
        return f"finished results are kept; resume: {command}"
    return f"no partial files remain; run it again: {command}"


def main(arguments: list[str] | None = None) -> None:
    """Run a command; exit 0 on success, 1 if input or run failed (one line on stderr), 2 on wrong usage."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    # Collecting garbage among the objects of imported libraries takes a second.
    gc.set_threshold(50_000)
    atexit.register(gc.freeze)
    for name, value in LIBRARIES.items():
        os.environ.setdefault(name, value)
    arguments = [a for a in arguments if a != "--debug"]
    if arguments[:1] == ["--version"]:
        print(f"offpiste {__version__}")  # noqa: T201
        sys.exit(0)
    try:
        commands = commands_in_order()
        if arguments and not arguments[0].startswith("-") and arguments[0] not in commands:
            print(f"offpiste: {_no_command(arguments[0], tuple(commands))}", file=sys.stderr)  # noqa: T201
            sys.exit(2)
        command = _parsed(arguments, commands)
        log_to_terminal()
        sys.exit(command.run())
    except OffpisteError as error:
        if debug:
            raise
        print(f"offpiste: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    except KeyboardInterrupt:
        print(f"offpiste: interrupted; {_again(arguments)}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    except BrokenPipeError:
        # The reader of a pipe, e.g. `head`, has closed it; flushing at exit would raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        said = user_error_of(error)
        if debug or said is None:
            raise
        print(f"offpiste: {said}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
