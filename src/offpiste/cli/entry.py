"""The command line: which commands there are, from arguments to one of them, and from its outcome to an exit code."""

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
    """A dataclass whose fields are the arguments; tyro makes the help of its docstrings."""

    def run(self) -> int:
        """Do it; the exit code: 0 done, 1 the input is unfit."""


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
"""Order of the commands in the help: as a log goes through them. Others follow."""


LIBRARIES: Final = {
    "OPENCV_LOG_LEVEL": "SILENT",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
}
"""What libraries read of the environment when they are imported: our errors say what is wrong with a picture, and
NumPy's products are too small for threads, which would spin beside ours. Threads of torch sleep where they wait: beside
another busy process each barrier would cost a slice of its time."""


_NO_ROOM: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NO_FOLDER: Final = {errno.EEXIST, errno.ENOTDIR}
_NOT_ALLOWED: Final = {errno.EACCES, errno.EPERM, errno.EROFS}
_MAKE_ROOM: Final = "make room on the disk and run it again; what was finished is kept"


def commands_in_order() -> dict[str, Callable[..., Command]]:
    """All commands by name, those of `PIPELINE` first."""
    order = {name: number for number, name in enumerate(PIPELINE)}
    return dict(sorted(COMMANDS.items(), key=lambda named: order.get(named[0], len(order))))


def user_error_of(error: OSError) -> OffpisteError | None:
    """An error of the operating system that a user can put right; None for others."""
    where = error.filename or "a file"
    if error.errno in _NO_FOLDER:
        return OffpisteError("is a file, or lies in one", where=where, how="give a folder as --out")
    if error.errno in _NO_ROOM:
        return OffpisteError(f"cannot be written: {error.strerror}", where=where, how=_MAKE_ROOM)
    if error.errno in _NOT_ALLOWED:
        how = "give files that you may read, and folders that you may write to"
        return OffpisteError(f"cannot be opened: {error.strerror}", where=where, how=how)
    if error.filename:
        return OffpisteError(f"cannot be used: {error.strerror}", where=where, how="give another path, or repair it")
    return None


def _no_command(word: str, commands: Sequence[str]) -> OffpisteError:
    """What is wrong with a first word that is no command."""
    how = f"{did_you_mean(word, commands)}Commands: {', '.join(commands)}"
    return OffpisteError(f"'{word}' is no command", how=how)


def _parsed(arguments: list[str], commands: dict[str, Callable[..., Command]]) -> Command:
    """The command that arguments ask for; on wrong usage or `--help`, prints and exits."""
    config = (tyro.conf.FlagCreatePairsOff,)
    if arguments and arguments[0] in commands:
        # Of this command alone: it starts sooner, and a wrong option brings up no options of others.
        name, *rest = arguments
        return tyro.cli(commands[name], prog=f"offpiste {name}", args=rest, config=config)
    about = (
        "Learns how an off-road vehicle will move on the ground ahead."
        " --version prints which offpiste this is; --debug shows tracebacks."
    )
    return tyro.extras.subcommand_cli_from_dict(
        commands, prog="offpiste", description=about, args=arguments, config=config
    )


RESUMING: Final = {
    "demo": (), "extract": (), "merge": (), "reproduce": (), "simulate": (), "train": ("--resume",),
}  # fmt: skip
"""Commands that resume where they were stopped, with the option that this takes."""


def _again(arguments: Sequence[str]) -> str:
    """Return what is left of an interrupted command, and how to continue."""
    name = arguments[0] if arguments else ""
    more = [each for each in RESUMING.get(name, ()) if each not in arguments]
    command = join(["offpiste", *arguments, *more])
    if name in RESUMING:
        return f"what was finished is kept; resume: {command}"
    return f"nothing is left half written; run it again: {command}"


def main(arguments: list[str] | None = None) -> None:
    """Run one command: exit 0 when done, 1 when the input or the run failed (one line on stderr), 2 on wrong usage."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    # What libraries make when they are imported stays: looking for garbage in it, and again at the end, takes a second.
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
        # The reader of a pipe has closed it, e.g. `head`; Python would complain when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        said = user_error_of(error)
        if debug or said is None:
            raise
        print(f"offpiste: {said}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
