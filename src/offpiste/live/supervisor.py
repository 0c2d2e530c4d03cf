"""Supervision of the processes of a drive: start, restart, and reports of their states."""

import logging
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from functools import cache
from importlib import import_module
from multiprocessing import connection, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final

import numpy as np

from offpiste.core.errors import LiveError, OffpisteError
from offpiste.core.signals import BACKGROUND, ENDING, group_signals_blocked, ignore_group_signals
from offpiste.live.command_messages import path_message
from offpiste.live.control import ENDS
from offpiste.live.map_and_plan import ground_height
from offpiste.live.part import AFTER, LOADING, Part
from offpiste.live.ring import Reader, layers_from, plan_from, unpacked
from offpiste.live.session import DIAGNOSTICS, MAP, PARTS, PLAN, LiveSettings, Session, new_session
from offpiste.logs.ros.grid_map import grid_map_from_layers
from offpiste.logs.ros.writer import header, make
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.rig.rig import load_rig
from offpiste.runtime.prediction import Prediction
from offpiste.transport.zenoh_transport import ZenohTransport

logger = logging.getLogger(__name__)

PERIOD: Final = 0.1
"""Time between checks of the processes [s]."""
_STALLED: Final = 1.5
"""Time without a sign of life after which a process counts as hung [s]."""
_KILLED: Final = 15.0
"""Time without a sign of life after which a process is restarted [s]; `_SOONER` has shorter ones."""
_SOONER: Final = {"control": 5.0, "watchdog": 5.0}
_LOADS: Final = 600.0
"""The same for a process that is loading its kernels or has not begun [s]."""
_SAY: Final = 1.0
"""Minimum time between logged states of one process [s]."""
_FRAME: Final = "map"
"""Frame of published messages if the vehicle's position messages name none."""
OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_EVERY: Final = 5
"""Step in states of the published path."""
_NICE: Final = {"codes": 5, "map": 5, "plan": 5, "record": 10, "view": 10}
"""Niceness, so that control has precedence on few cores."""
_FIRST_KILLED: Final = {"codes": 300, "map": 300, "plan": 300, "record": 500, "view": 500}
"""Value of oom_score_adj: if memory runs out, the kernel spares the processes that stop the vehicle."""
States = Mapping[str, tuple[int, str, Mapping[str, Any]]]
"""Level, state and numbers of each process."""


def run_part(name: str, session: Session) -> None:
    """Run a process to its end; an error becomes its last state, and its exit code 1."""
    ignore_group_signals()  # Ctrl-C, systemd or a lost terminal must not end the stop: the parent ends processes
    if (parent := parent_process()) is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()
    if name == "watchdog":
        os.setsid()  # signals to the group, including SIGSTOP, do not reach the process that stops the vehicle
    os.nice(_NICE.get(name, 0))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(_FIRST_KILLED.get(name, 0)))
    try:
        module, _, function = PARTS[name].partition(".")
        getattr(import_module(f"offpiste.live.{module}"), function)(session)  # control and planning are loaded already
    except Exception as error:
        foreseen = isinstance(error, OffpisteError)
        with suppress(LiveError):  # the session's memory may have been removed
            Part(name, session).report(str(error) if foreseen else f"{type(error).__name__}: {error}"[:300])
        if foreseen:
            sys.exit(1)
        raise


def _end_after(parent: int) -> None:
    """End this process some time after its parent, even if it compiles or hangs."""
    connection.wait([parent])
    time.sleep(AFTER + 2.0)
    os._exit(1)


class Supervisor:
    """Start the processes of a session, restart them when needed, and report their states.

    Args:
        transport: for the reports.
        names: of the processes to be started if the settings need them.

    Attributes:
        restarts: number of restarts of each process.
    """

    def __init__(self, session: Session, transport: ZenohTransport, names: Iterable[str] = PARTS) -> None:
        settings = session.settings
        # The server imports shared modules once, has no threads, and forks each process.
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["offpiste.live.supervisor"])
        self._session, self._ring = session, cache(session.ring)
        wanted = {
            "codes": settings.cameras,
            "watchdog": settings.drive,
            "record": settings.record,
            "view": settings.view,
        }
        self._names = [name for name in names if wanted.get(name, True)]
        self._processes: dict[str, BaseProcess] = {}
        self._handles: dict[str, int] = {}
        self._started: dict[str, float] = {}
        self.restarts = dict.fromkeys(self._names, 0)
        self._again = dict.fromkeys(self._names, 0.0)
        self._said = dict.fromkeys(self._names, ("", 0.0))
        self._publish_plan = transport.publisher(PLAN, "nav_msgs/msg/Path")
        self._publish_map = transport.publisher(MAP, "grid_map_msgs/msg/GridMap")
        self._publish_states = transport.publisher(DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray")
        self._plans, self._maps = Reader(self._ring("plans"), 0), Reader(self._ring("map"), 0)
        self._layers: TerrainLayers | None = None

    def start(self) -> None:
        """Start all processes."""
        for name in self._names:
            self._start(name)

    def look(self) -> States:
        """Return the states of all processes, and restart those that died or hang."""
        return {name: self._look_at(name) for name in self._names}

    def report(self, parts: States) -> None:
        """Publish the diagnostics, and the newest plan and map."""
        self._publish_states(diagnostics_message(parts, time.time_ns()))
        frame = str(parts["receive"][2].get("frame", "") if "receive" in parts else "") or _FRAME
        if (values := self._maps.newest()) is not None:
            self._layers = layers_from(values)
            if self._layers is not None:
                self._publish_map(map_message(self._layers, round(values["scan_time"] * 1e9), frame))
        if (values := self._plans.newest()) is not None and "start" in values:
            prediction = plan_from(values).prediction
            self._publish_plan(plan_message(prediction, round(prediction.time * 1e9), frame, self._layers))

    def say(self, parts: States) -> None:
        """Log changed states."""
        now = time.monotonic()
        for name, (level, state, _) in parts.items():
            said, at = self._said[name]
            if said != state and now - at > _SAY:
                self._said[name] = state, now
                begins = state in ("starts", LOADING) or state.startswith("waits")
                (logger.info if level == OK or begins else logger.warning)(f"{name}: {state}")

    def end(self) -> None:
        """End all processes: control and the watchdog after the vehicle has stopped, then the others."""
        self._ring("end").write(b"stop the vehicle")
        self._await(("control",), ENDS + 1.0)
        self._await(("watchdog",), ENDS + 3.0)
        self._ring("end").write(b"end")
        self._await(tuple(self._processes), 3.0)
        for process in self._processes.values():
            process.join(1.0)

    def _await(self, names: Sequence[str], seconds: float) -> None:
        """Wait for processes to end, and kill those that do not."""
        until = time.monotonic() + seconds
        for name in names:
            if name in self._handles:  # `join` would return at once if the server that forked it has ended
                connection.wait([self._handles[name]], max(until - time.monotonic(), 0.0))
                self._kill(name)

    def _start(self, name: str) -> None:
        self._kill(name)
        process = self._context.Process(
            target=run_part, args=(name, self._session), name=f"offpiste {name}", daemon=True
        )
        with group_signals_blocked():  # inherited by the server that forks processes
            process.start()
        self._processes[name], self._started[name] = process, time.monotonic()
        with suppress(ProcessLookupError):  # it has already ended
            self._handles[name] = os.pidfd_open(process.pid or 0)

    def _kill(self, name: str) -> None:
        """Kill a process by its handle, even if the server that forked it died and it only seems to have ended."""
        if (handle := self._handles.pop(name, None)) is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(handle, signal.SIGKILL)
            os.close(handle)

    def _look_at(self, name: str) -> tuple[int, str, Mapping[str, Any]]:
        process, ring = self._processes[name], self._ring(f"status-{name}")
        newest = ring.newest()
        values = {} if newest is None else unpacked(newest.data)
        state, about = str(values.pop("state", "")), values | {"restarts": self.restarts[name]}
        now, begun = time.monotonic(), newest is not None and values.get("pid") == process.pid
        if not process.is_alive():
            code = process.exitcode
            if name == "record" and code == 0:  # the disk is full, or the file cannot be written: it would end again
                return ERROR, f"ended: {state if begun else 'before it began'}", about
            if now >= self._again[name]:
                self.restarts[name] += 1
                self._again[name] = now + min(0.1 * self.restarts[name], 2.0)
                self._start(name)
            why = f" ({state})" if begun and code == 1 else ""
            return ERROR, f"ended with {code}{why}, and is started again", about
        waits = ring.age if begun else now - self._started[name]
        loads = not begun or state == LOADING
        if waits > (_LOADS if loads else _SOONER.get(name, _KILLED)):
            self._kill(name)
        if not begun:
            return WARN, "starts", about
        if waits > _STALLED and not loads:
            return ERROR, "gives no sign of life", about
        good = state in ("ready", "driving") or state.startswith(("records", "shows"))
        return (OK if good else WARN), state, about


def plan_message(prediction: Prediction, stamp_ns: int, frame: str, layers: TerrainLayers | None) -> Any:
    """Return the predicted trajectory on the ground as a nav_msgs/Path.

    Unknown heights are interpolated, or set to 0 if none is known.
    """
    places = prediction.state[::_EVERY, :3]
    height = np.full(len(places), np.nan) if layers is None else ground_height(layers, places[:, :2])
    known = np.flatnonzero(np.isfinite(height))
    height = np.interp(np.arange(len(height)), known, height[known]) if len(known) else np.zeros(len(height))
    return path_message(np.column_stack((places[:, :2], height)), places[:, 2], stamp_ns, frame)


def map_message(layers: TerrainLayers, stamp_ns: int, frame: str) -> Any:
    """Return a grid_map_msgs/GridMap of elevation, slope, roughness and obstacle height; NaN where unknown."""
    names = ("elevation", "slope", "roughness", "obstacle_height")
    shown = {name: np.asarray(getattr(layers, name), np.float64) for name in names}
    origin = (float(layers.origin[0]), float(layers.origin[1]))
    return grid_map_from_layers(shown, origin, layers.resolution, stamp_ns=stamp_ns, frame=frame)


def diagnostics_message(parts: States, stamp_ns: int) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray of the processes."""
    status = []
    for name, (level, message, numbers) in parts.items():
        pairs = [make("diagnostic_msgs/KeyValue", key=key, value=text) for key, text in _texts(numbers)]
        named = {"name": f"offpiste: {name}", "message": message, "hardware_id": ""}
        status.append(make("diagnostic_msgs/DiagnosticStatus", level=level, values=pairs, **named))
    return make("diagnostic_msgs/DiagnosticArray", header=header(stamp_ns, ""), status=status)


def _texts(numbers: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield names and numbers as strings; a mapping yields each of its entries."""
    for key, value in numbers.items():
        if isinstance(value, Mapping):
            yield from ((f"{key}: {name}", str(count)) for name, count in value.items())
        else:
            yield key, f"{value:.4g}" if isinstance(value, float) else str(value)


def notify(**state: object) -> None:
    """Send a state to a service manager (systemd's sd_notify), e.g. `notify(READY=1, STATUS="drives")`; never wait."""
    if address := os.environ.get("NOTIFY_SOCKET", ""):
        address = f"\0{address[1:]}" if address.startswith("@") else address
        lines = "\n".join(f"{name}={' '.join(str(value).split())}" for name, value in state.items())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sender:
                sender.sendto(lines.encode(), address)
        except OSError as error:
            _warn_once(f"the service manager is not notified: {error.strerror or error} ($NOTIFY_SOCKET)")


@cache
def _warn_once(text: str) -> None:
    logger.warning(text)


def supervise(settings: LiveSettings) -> None:
    """Drive, or watch, until the time is over, Ctrl-C, or an ending signal."""
    with ExitStack() as stack:
        asked = stack.enter_context(end_requested())
        robot = stack.enter_context(settings.robot.hosted())
        transport = stack.enter_context(closing(ZenohTransport(robot, load_rig(settings.rig).live.definitions)))
        session = stack.enter_context(new_session(replace(settings, robot=robot)))
        supervisor = Supervisor(session, transport)
        began = looked = time.monotonic()
        try:
            supervisor.start()
            notify(READY=1)
            while time.monotonic() - began < settings.seconds and not asked.wait(PERIOD):
                parts = supervisor.look()
                supervisor.say(parts)
                if time.monotonic() - looked >= 0.5:
                    looked = time.monotonic()
                    supervisor.report(parts)
                    said = (f"{name}: {one[1]}" for name, one in parts.items() if one[0] != OK or name == "control")
                    notify(WATCHDOG=1, STATUS="; ".join(said)[:500])  # here, because it shows that this loop runs
        except KeyboardInterrupt:
            logger.info("the vehicle is stopped" if settings.drive else "the drive ends")
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C would cut the stop short
            notify(STOPPING=1, STATUS="ends the drive")
            supervisor.end()


@contextmanager
def end_requested() -> Iterator[threading.Event]:
    """Yield an event that SIGTERM (a service manager), SIGHUP (a lost terminal), SIGQUIT or Ctrl-Z sets.

    Ctrl-C raises. A drive is never suspended, by Ctrl-Z or by output in the background, as its processes would
    continue without supervision.
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
