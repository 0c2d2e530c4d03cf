"""Commands in forked processes with limits on time, memory and disk."""

import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

MEMORY = 2 << 30
"""Largest resident memory [bytes]."""
ADDRESSES = 6 << 30
"""Additional address space of a fork [bytes]; libraries reserve more than they use."""
DISK = 1 << 30
"""Largest file [bytes]."""
PROCESSOR = 120
"""Longest processor time [s]."""
WALL = 900
"""Longest wall-clock time [s]."""

TRACEBACK, OUT_OF_MEMORY = 70, 71
"""Exit codes of processes that ended with an exception."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a process.

    Attributes:
        code: exit code, or the negative number of the signal that killed it.
        hung: exceeded a time limit.
        memory: largest resident memory [bytes].
        out, err: standard output and error.
    """

    code: int
    hung: bool
    seconds: float
    memory: int
    out: str
    err: str


def run_isolated(work: Callable[[], object], folder: Path) -> Outcome:
    """Call `work` in a fork of this process; its output goes to files in an existing folder."""
    sys.stdout.flush()
    sys.stderr.flush()
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        _in_child(work, folder)
    _, status, usage = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    hung = code in (-signal.SIGXCPU, -signal.SIGALRM)
    out, err = ((folder / name).read_text("utf-8", "replace") for name in ("out.txt", "err.txt"))
    return Outcome(code, hung, time.monotonic() - start, usage.ru_maxrss << 10, out, err)


def _in_child(work: Callable[[], object], folder: Path) -> None:
    code = TRACEBACK
    try:
        os.setsid()
        for name, number in (("out.txt", 1), ("err.txt", 2)):
            os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        addresses = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (addresses + ADDRESSES, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_FSIZE, (DISK, DISK))
        resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR, PROCESSOR + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        signal.alarm(WALL)
        warnings.resetwarnings()
        warnings.simplefilter("ignore", DeprecationWarning)
        code = _exit_code(work)
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _exit_code(work: Callable[[], object]) -> int:
    try:
        work()
    except SystemExit as exit_:
        return int(exit_.code or 0)
    except MemoryError:
        traceback.print_exc()
        return OUT_OF_MEMORY
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
        return TRACEBACK
    return 0


def run_apart(work: Callable[[], object], folder: Path) -> Outcome:
    """Call `work` as `run_isolated` does, in a fork of a server.

    The resident memory of a fork starts at that of its parent, and this process may be large.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["offpiste.inspection.inspect", "offpiste.logs.formats.table"])
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(run_isolated, work, folder).result()


def run_command_apart(arguments: Sequence[str], folder: Path) -> Outcome:
    """Run a command of the command line as `run_apart`."""
    return run_apart(partial(_run_command, tuple(arguments)), folder)


def _run_command(arguments: tuple[str, ...]) -> None:
    from offpiste.cli import main
    from offpiste.core import progress

    progress.EVERY = float("inf")  # progress lines depend on the machine
    main(list(arguments))
