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
    "demo", "simulate", "inspect", "view", "fit-pca", "extract", "train", "evaluate", "calibrate", "reproduce", "drive",
    "doctor", "live", "play", "export", "check", "merge",
)  # fmt: skip
"""Order of commands in the help; others follow."""

LIBRARIES: Final = {
    "OPENCV_LOG_LEVEL": "SILENT",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
}
"""Environment variables that libraries read on import. OpenCV's messages would repeat our errors, BLAS threads would
spin beside ours, and waiting OpenMP threads would take time from other processes."""


def commands_in_order() -> dict[str, Callable[..., Command]]:
    """Return all commands by name, in the order of `PIPELINE`."""
    order = {name: number for number, name in enumerate(PIPELINE)}
    return dict(sorted(COMMANDS.items(), key=lambda named: order.get(named[0], len(order))))


def user_error_of(error: OSError) -> OffpisteError | None:
    """Return the error for users of an error of the operating system; None if it names no file."""
    where = error.filename or "a file"
    if error.errno in {errno.EEXIST, errno.ENOTDIR}:
        return OffpisteError("is a file, or is inside one", where=where, how="give a folder as --out")
    if error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}:
        how = "make room on the disk and run it again; finished results are kept"
        return OffpisteError(f"cannot be written: {error.strerror}", where=where, how=how)
    if error.errno in {errno.EACCES, errno.EPERM, errno.EROFS}:
        how = "give readable files and writable folders"
        return OffpisteError(f"cannot be opened: {error.strerror}", where=where, how=how)
    if error.filename:
        return OffpisteError(f"cannot be used: {error.strerror}", where=where, how="give another path, or repair it")
    return None


def parse(arguments: list[str], commands: dict[str, Callable[..., Command]]) -> Command:
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


RESUMABLE: Final = ("demo", "extract", "merge", "reproduce", "simulate", "train")
"""Commands that can be resumed."""


def _again(arguments: Sequence[str]) -> str:
    """Return the command line that continues an interrupted command."""
    name = arguments[0] if arguments else ""
    more = ["--resume"] if name == "train" and "--resume" not in arguments else []
    what = "finished results are kept; resume" if name in RESUMABLE else "no partial files remain; run it again"
    return f"{what}: {join(['offpiste', *arguments, *more])}"


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
            how = f"{did_you_mean(arguments[0], commands)}Commands: {', '.join(commands)}"
            unknown = OffpisteError(f"unknown command '{arguments[0]}'", how=how)
            print(f"offpiste: {unknown}", file=sys.stderr)  # noqa: T201
            sys.exit(2)
        command = parse(arguments, commands)
        log_to_terminal()
        sys.exit(command.run())
    except BrokenPipeError:
        # The reader of a pipe, e.g. `head`, has closed it; flushing at exit would raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        print(f"offpiste: interrupted; {_again(arguments)}", file=sys.stderr)  # noqa: T201
    except (OffpisteError, OSError) as error:
        said = user_error_of(error) if isinstance(error, OSError) else error
        if debug or said is None:
            raise
        print(f"offpiste: {said}", file=sys.stderr)  # noqa: T201
    sys.exit(1)
