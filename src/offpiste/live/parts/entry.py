"""Where a process of a drive begins."""

import os
import sys

from offpiste.errors import OffpisteError
from offpiste.live.part import Part
from offpiste.live.session import Session

_NICE = {"codes": 5, "map": 5, "plan": 5, "record": 10, "view": 10}
"""How much other processes come first: where there are few cores, control is not held up."""

SAID = 3
"""Exit code of a process whose last state says why it ended."""


def run_part(name: str, session: Session, cameras: bool) -> None:
    """Run a process to its end; an error of ours becomes its last state, and its exit code `SAID`."""
    os.nice(_NICE.get(name, 0))
    try:
        _run(name, session, cameras)
    except OffpisteError as error:
        Part(name, session).end_with(str(error))
        sys.exit(SAID)


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

        record(session, cameras=cameras)
    else:
        from offpiste.live.parts.view import view

        view(session, cameras=cameras)
