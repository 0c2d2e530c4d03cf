"""Watches over the processes of a drive: starts them, starts again what died or hangs, and says how all are."""

import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final

from offpiste.core.signals import BACKGROUND, ENDING, group_signals_blocked
from offpiste.live.packing import layers_from, plan_from, unpacked
from offpiste.live.parts.entry import run_part
from offpiste.live.parts.setup import LOADING
from offpiste.live.parts.watchdog import ENDS
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
from offpiste.live.service_manager import ServiceManager
from offpiste.live.session import PARTS, LiveSettings, Session, new_session
from offpiste.live.status_table import StatusTable
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.runtime.planner import Planner
from offpiste.transport.interface import Transport

logger = logging.getLogger(__name__)

PERIOD: Final = 0.1
"""Time from one look at the processes to the next [s]."""
_STALLED: Final = 1.5
"""Time without a sign of life, after which a process that was ready counts as hung [s]."""
_KILLED: Final = 15.0
"""The same, after which it is started again [s]; `_SOONER` for those that only have to be quick."""
_SOONER: Final = {"control": 5.0, "watchdog": 5.0}
_LOADS: Final = 600.0
"""A process that compiles its kernels, or has not begun, is started again after so long [s]."""
_SAY: Final = 1.0
"""States of one process are logged no more often [s]."""
_FRAME: Final = "map"
"""Frame of what is published, where the messages of the vehicle's position name none."""


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
        self._handles: dict[str, int] = {}
        self._started: dict[str, float] = {}
        self.restarts = dict.fromkeys(self._names, 0)
        self._again = dict.fromkeys(self._names, 0.0)
        self._publish: dict[str, Callable[[Any], None]] = {
            PLAN: transport.publisher(PLAN, "nav_msgs/msg/Path"),
            MAP: transport.publisher(MAP, "grid_map_msgs/msg/GridMap"),
            DIAGNOSTICS: transport.publisher(DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray"),
        }
        self._numbers = {"plans": 0, "map": 0}
        self._layers: TerrainLayers | None = None
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
        frame = str(parts["receive"][2].get("frame", "") if "receive" in parts else "") or _FRAME
        if (values := self._newer("map")) is not None:
            self._layers = layers_from(values)
            if self._layers is not None:
                self._publish[MAP](map_message(self._layers, round(values["scan_time"] * 1e9), frame))
        if (values := self._newer("plans")) is not None and "start" in values:
            timed, prediction = plan_from(values)
            self._publish[PLAN](path_message(prediction, round(timed.start * 1e9), frame, self._layers))

    def say(self, parts: Mapping[str, tuple[int, str, Mapping[str, Any]]]) -> None:
        """Log what has changed."""
        now = time.monotonic()
        for name, (level, state, _) in parts.items():
            said, at = self._said.get(name, ("", 0.0))
            if said != state and now - at > _SAY:
                self._said[name] = state, now
                begins = state in ("starts", LOADING) or state.startswith("waits")
                (logger.info if level == OK or begins else logger.warning)(f"{name}: {state}")

    def end(self) -> None:
        """End all processes: control and the watchdog once the vehicle is at a standstill, then the others."""
        self._ring("end").write(b"stop the vehicle")
        self._await(("control",), ENDS + 1.0)
        self._await(("watchdog",), ENDS + 3.0)
        self._ring("end").write(b"end")
        self._await(tuple(self._processes), 3.0)
        for process in self._processes.values():
            process.join(1.0)

    def _await(self, names: Sequence[str], seconds: float) -> None:
        """Wait for processes to end; end those that do not."""
        until = time.monotonic() + seconds
        for name in names:
            if name in self._handles:  # and not `join`, which returns at once where the server that forked it is gone
                connection.wait([self._handles[name]], max(until - time.monotonic(), 0.0))
                self._kill(name)

    def _start(self, name: str) -> None:
        self._kill(name)
        process = self._context.Process(
            target=run_part, args=(name, self._session, self._cameras), name=f"offpiste {name}", daemon=True
        )
        with group_signals_blocked():  # also in the server that forks them
            process.start()
        self._processes[name], self._started[name] = process, time.monotonic()
        with suppress(ProcessLookupError):  # it has ended already
            self._handles[name] = os.pidfd_open(process.pid or 0)

    def _kill(self, name: str) -> None:
        """End a process for certain: where the server that forked it died, it only seems to have ended."""
        if (handle := self._handles.pop(name, None)) is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(handle, signal.SIGKILL)
            os.close(handle)

    def _look_at(self, name: str) -> tuple[int, str, Mapping[str, Any]]:
        process, ring = self._processes[name], self._ring(f"status-{name}")
        newest = ring.newest()
        values = {} if newest is None else unpacked(newest.data)
        about = {key: value for key, value in values.items() if key != "state"} | {"restarts": self.restarts[name]}
        now, begun = time.monotonic(), newest is not None and values.get("pid") == process.pid
        if not process.is_alive():
            code = process.exitcode
            if name == "record" and code == 0:  # no room, or no such file: it would end again
                return ERROR, f"ended: {values['state'] if begun else 'before it began'}", about
            if now >= self._again[name]:
                self.restarts[name] += 1
                self._again[name] = now + min(0.1 * self.restarts[name], 2.0)
                self._start(name)
            why = f" ({values['state']})" if begun and code == 1 else ""
            return ERROR, f"ended with {code}{why}, and is started again", about
        waits = now - self._started[name] if not begun else ring.age
        if waits > (_LOADS if not begun or values["state"] == LOADING else _SOONER.get(name, _KILLED)):
            self._kill(name)
        if not begun:
            return WARN, "starts", about
        if waits > _STALLED and values["state"] != LOADING:
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
    """Drive, or watch, until the time is up, Ctrl-C, or a signal to end.

    Raises:
        OffpisteError: no connection, or no shared memory.
    """
    with ExitStack() as stack:
        asked = stack.enter_context(asked_to_end())
        robot = stack.enter_context(settings.robot.hosted())
        transport = robot.connect(definitions)
        stack.callback(transport.close)
        session = stack.enter_context(new_session(replace(settings, robot=robot)))
        table = stack.enter_context(StatusTable(settings.status))
        supervisor = Supervisor(session, transport, cameras=planner.extractor is not None)
        manager = ServiceManager()
        began = looked = time.monotonic()
        try:
            supervisor.start()
            manager.notify(READY=1)
            while time.monotonic() - began < settings.seconds and not asked.wait(PERIOD):
                parts = supervisor.look()
                supervisor.say(parts)
                if time.monotonic() - looked >= 0.5:
                    looked = time.monotonic()
                    supervisor.report(parts)
                    table.add(looked - began, parts)
                    manager.notify(WATCHDOG=1, STATUS=summary(parts))  # here, as only this loop shows that it runs
        except KeyboardInterrupt:
            logger.info("the vehicle is stopped" if settings.drive else "the drive ends")
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C would cut the stop short
            manager.notify(STOPPING=1, STATUS="ends the drive")
            supervisor.end()


def summary(parts: Mapping[str, tuple[int, str, Mapping[str, Any]]]) -> str:
    """States of control and of the processes that are not as they should be, in one line."""
    said = [f"{name}: {state}" for name, (level, state, _) in parts.items() if level != OK or name == "control"]
    return "; ".join(said)[:500]


@contextmanager
def asked_to_end() -> Iterator[threading.Event]:
    """Set once a service manager (SIGTERM), a terminal that is gone (SIGHUP), SIGQUIT or Ctrl-Z ends the drive.

    Ctrl-C raises. A drive is not suspended, by Ctrl-Z or for what it prints in the background: its processes would
    drive on without supervision.
    """
    asked = threading.Event()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *ENDING, *BACKGROUND)}
    for number in ENDING:
        if before[number] != signal.SIG_IGN:  # as nohup sets it
            signal.signal(number, lambda *_: asked.set())
    for number in BACKGROUND:
        signal.signal(number, signal.SIG_IGN)
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
