"""Watches over the processes of a drive: starts them, starts again what died or hangs, and says how all are."""

import logging
import multiprocessing
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final

from offpiste.closed_loop.planner import Planner
from offpiste.live.packing import layers_from, plan_from, unpacked
from offpiste.live.parts.entry import SAID, run_part
from offpiste.live.parts.setup import LOADING
from offpiste.live.reports import (
    DIAGNOSTICS,
    ERROR,
    MAP,
    OK,
    PLAN,
    WARN,
    diagnostics_message,
    map_message,
    path_message,
)
from offpiste.live.ring import Ring
from offpiste.live.session import PARTS, LiveSettings, Session, new_session
from offpiste.live.status_table import StatusTable
from offpiste.transport.interface import Transport

logger = logging.getLogger(__name__)

PERIOD: Final = 0.1
"""Time from one look at the processes to the next [s]."""
_STALLED: Final = 1.5
"""Time without a sign of life, after which a process that was ready counts as hung [s]."""
_KILLED: Final = 15.0
"""The same, after which it is started again [s]: kernels may be compiled meanwhile."""
_SAY: Final = 1.0
"""States of one process are logged no more often [s]."""
_FRAME: Final = "map"


class Supervisor:
    """Starts the processes of a session, and looks after them.

    Args:
        transport: what is reported goes out by.
        cameras: whether the model reads images.
        names: of the processes that are started, where they are needed.

    Attributes:
        restarts: how often each process was started again.
    """

    def __init__(self, session: Session, transport: Transport, *, cameras: bool, names: Sequence[str] = PARTS) -> None:
        self._session, self._transport, settings = session, transport, session.settings
        # What all need is imported once, and shared; the server has no threads, and forks one process for each part.
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["offpiste.live.parts.control", "offpiste.live.parts.plan"])
        self._cameras = cameras
        wanted = {"codes": self._cameras, "watchdog": settings.drive, "record": settings.record is not None}
        wanted["view"] = settings.view is not None
        self._names = [name for name in names if wanted.get(name, True)]
        self._rings: dict[str, Ring] = {}
        self._processes: dict[str, BaseProcess] = {}
        self.restarts = dict.fromkeys(self._names, 0)
        self._again = dict.fromkeys(self._names, 0.0)
        self._publish: dict[str, Callable[[Any], None]] = {
            PLAN: transport.publisher(PLAN, "nav_msgs/msg/Path"),
            MAP: transport.publisher(MAP, "grid_map_msgs/msg/GridMap"),
            DIAGNOSTICS: transport.publisher(DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray"),
        }
        self._numbers = {"plans": 0, "map": 0}
        self._said: dict[str, tuple[str, float]] = {}

    def start(self) -> None:
        """Start all processes."""
        for name in self._names:
            self._start(name)

    def look(self) -> dict[str, tuple[int, str, Mapping[str, Any]]]:
        """Level, state in words and numbers of each process; what died or hangs is started again."""
        return {name: self._look_at(name) for name in self._names}

    def report(self, parts: Mapping[str, tuple[int, str, Mapping[str, Any]]]) -> None:
        """Publish the diagnostics, and the newest plan and map."""
        now = time.time_ns()
        self._publish[DIAGNOSTICS](diagnostics_message(parts, now))
        if (values := self._newer("plans")) is not None and "start" in values:
            timed, prediction = plan_from(values)
            self._publish[PLAN](path_message(prediction, round(timed.start * 1e9), _FRAME))
        if (values := self._newer("map")) is not None and (layers := layers_from(values)) is not None:
            self._publish[MAP](map_message(layers, round(values["scan_time"] * 1e9), _FRAME))

    def say(self, parts: Mapping[str, tuple[int, str, Mapping[str, Any]]]) -> None:
        """Log what has changed."""
        now = time.monotonic()
        for name, (level, state, _) in parts.items():
            said, at = self._said.get(name, ("", 0.0))
            if said != state and now - at > _SAY:
                self._said[name] = state, now
                (logger.info if level == OK else logger.warning)(f"{name}: {state}")

    def end(self) -> None:
        """End all processes; the vehicle is stopped before control ends."""
        self._ring("end").write(b"end")
        until = time.monotonic() + 3.0
        for process in self._processes.values():
            process.join(max(until - time.monotonic(), 0.0))
        for process in self._processes.values():
            process.kill()
            process.join(1.0)

    def _start(self, name: str) -> None:
        process = self._context.Process(
            target=run_part, args=(name, self._session, self._cameras), name=f"offpiste {name}", daemon=True
        )
        process.start()
        self._processes[name] = process

    def _look_at(self, name: str) -> tuple[int, str, Mapping[str, Any]]:
        process, ring = self._processes[name], self._ring(f"status-{name}")
        newest = ring.newest()
        values = {} if newest is None else unpacked(newest.data)
        about = {key: value for key, value in values.items() if key != "state"} | {"restarts": self.restarts[name]}
        if not process.is_alive():
            code = process.exitcode
            if name == "record":
                return ERROR, f"ended: {values.get('state', 'before it began')}", about
            if time.monotonic() >= self._again[name]:
                self.restarts[name] += 1
                self._again[name] = time.monotonic() + min(0.1 * self.restarts[name], 2.0)
                self._start(name)
            how = values.get("state", code) if code == SAID else code
            return ERROR, f"ended with {how}, and is started again", about
        if newest is None or values.get("pid") != process.pid:
            return WARN, "starts", about
        if ring.age > _STALLED and values["state"] != LOADING:
            if ring.age > _KILLED:
                process.kill()
            return ERROR, "gives no sign of life", about
        state = str(values["state"])
        good = state in ("ready", "driving") or state.startswith(("records", "shows"))
        return (OK if good else WARN), state, about

    def _newer(self, name: str) -> dict[str, Any] | None:
        newest = self._ring(name).newest()
        if newest is None or newest.number == self._numbers[name]:
            return None
        self._numbers[name] = newest.number
        return unpacked(newest.data)

    def _ring(self, name: str) -> Ring:
        if name not in self._rings:
            self._rings[name] = self._session.ring(name)
        return self._rings[name]


def supervise(settings: LiveSettings, planner: Planner, definitions: list[Path]) -> None:
    """Drive, or watch, until the time is up or Ctrl-C.

    Raises:
        OffpisteError: no connection, or no shared memory.
    """
    with ExitStack() as stack:
        transport = settings.robot.connect(definitions)
        stack.callback(transport.close)
        session = stack.enter_context(new_session(replace(settings, robot=settings.robot.for_parts())))
        table = stack.enter_context(StatusTable(settings.status))
        supervisor = Supervisor(session, transport, cameras=planner.extractor is not None)
        supervisor.start()
        began = looked = time.monotonic()
        try:
            while time.monotonic() - began < settings.seconds:
                parts = supervisor.look()
                supervisor.say(parts)
                if time.monotonic() - looked >= 0.5:
                    looked = time.monotonic()
                    supervisor.report(parts)
                    table.add(looked - began, parts)
                time.sleep(PERIOD)
        finally:
            supervisor.end()
