"""Signals that a terminal or service manager sends to all processes of a command."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Final

ENDING: Final = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)
"""Signals that end a drive, in addition to Ctrl-C."""
BACKGROUND: Final = (signal.SIGTTIN, signal.SIGTTOU)
"""Signals that stop background processes which use the terminal."""
GROUP_SIGNALS: Final = (signal.SIGINT, signal.SIGABRT, *ENDING, *BACKGROUND)
"""Signals that only the main process handles; systemd sends SIGABRT when its watchdog expires."""


def ignore_group_signals() -> None:
    """Ignore `GROUP_SIGNALS` in this process."""
    for number in GROUP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def group_signals_blocked() -> Iterator[None]:
    """Block `GROUP_SIGNALS`, also in processes started inside."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, GROUP_SIGNALS)
    resource_tracker.ensure_running()  # where Ctrl-Z stopped it, Python 3.12 would wait for it at its exit
    signal.pthread_sigmask(signal.SIG_BLOCK, GROUP_SIGNALS)  # starting it unblocks two of them
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
