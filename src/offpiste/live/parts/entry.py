"""Where a process of a drive begins."""

import os
import sys
import threading
import time
from contextlib import suppress
from multiprocessing import connection, parent_process
from pathlib import Path

from offpiste.core.errors import LiveError, OffpisteError
from offpiste.core.signals import ignore_group_signals
from offpiste.live.part import AFTER, Part
from offpiste.live.session import Session

_NICE = {"codes": 5, "map": 5, "plan": 5, "record": 10, "view": 10}
"""How much other processes come first: where there are few cores, control is not held up."""
_FIRST_KILLED = {"codes": 300, "map": 300, "plan": 300, "record": 500, "view": 500}
"""Where memory runs out, the kernel kills these rather than what stops the vehicle (oom_score_adj)."""


def run_part(name: str, session: Session, cameras: bool) -> None:
    """Run a process to its end; an error becomes its last state, and its exit code 1."""
    _leave_ending_to_the_parent()
    if name == "watchdog":
        os.setsid()  # a signal to the whole group, SIGSTOP included, does not reach what stops the vehicle
    os.nice(_NICE.get(name, 0))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(_FIRST_KILLED.get(name, 0)))
    try:
        _run(name, session, cameras)
    except OffpisteError as error:
        _leave(name, session, str(error))
        sys.exit(1)
    except Exception as error:
        _leave(name, session, f"{type(error).__name__}: {error}"[:300])
        raise


def _leave(name: str, session: Session, state: str) -> None:
    """Leave a last state, where the session's memory is still there."""
    with suppress(LiveError):
        Part(name, session).end_with(state)


def _leave_ending_to_the_parent() -> None:
    """End only as the parent says: a signal to all at once (Ctrl-C, systemd, a lost terminal) must not end the stop."""
    ignore_group_signals()
    if (parent := parent_process()) is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(parent: int) -> None:
    """End some time after the parent, wherever this process is: it may be compiling, or hang."""
    connection.wait([parent])
    time.sleep(AFTER + 2.0)
    os._exit(1)


def _run(name: str, session: Session, cameras: bool) -> None:
    """Import only what this process needs."""
    if name == "receive":
        from offpiste.live.parts.receive import receive

        receive(session, cameras=cameras)
    elif name == "codes":
        from offpiste.live.parts.codes import codes

        codes(session)
    elif name == "map":
        from offpiste.live.parts.map import map_ground

        map_ground(session)
    elif name == "plan":
        from offpiste.live.parts.plan import plan

        plan(session)
    elif name == "control":
        from offpiste.live.parts.control import control

        control(session)
    elif name == "watchdog":
        from offpiste.live.parts.watchdog import watchdog

        watchdog(session)
    elif name == "record":
        from offpiste.live.parts.record import record

        record(session)
    else:
        from offpiste.live.parts.view import view

        view(session, cameras=cameras)
