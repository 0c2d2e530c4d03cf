"""A simulator, `offpiste live --drive`, and a listener of its own that hears what the vehicle hears."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from experiments.live_faults.network import Link, Router
from experiments.live_faults.programs import begun, ended
from offpiste.runtime.settings import RuntimeSettings
from offpiste.transport.interface import Received
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport

COMMAND: Final = "/command"
"""Topic of the commands of the rig `proving_ground` (sensor_msgs/Joy: throttle, brake, steer)."""
ODOMETRY: Final = "/odometry"
_FOR: Final = 1.0
"""It counts as driving once it has driven for so long [s]."""


class Bench:
    """One drive; ended with the course, or by a fault from which it does not resume.

    Args:
        folder: for what the two programs say, and the recording.
        world, seed, speed: of the simulator [m/s].
        run: that is driven with.

    Attributes:
        recording: of `live`.
    """

    def __init__(self, folder: Path, world: str, seed: int, speed: float, run: str) -> None:
        folder.mkdir(parents=True)
        self.recording, self._modes = folder / "drive.mcap", list[tuple[float, str]]()
        self._commands: list[tuple[float, float, float]] = []
        self._diagnostics: list[tuple[float, frozenset[str]]] = []
        self.pids: dict[str, int] = {}
        self.router = Router()
        self.link = Link(self.router)
        self.session = ZenohTransport(ZenohSettings(endpoint=f"tcp/127.0.0.1:{self.router.port}"))
        self.last_odometry: Received | None = None
        self._subscribe()
        simulator = ["simulate", "--live", "--endpoint", f"tcp/127.0.0.1:{self.router.port}", "--world", world,
                     "--seed", str(seed), "--speed", str(speed), "--seconds", "600"]  # fmt: skip
        live = ["live", "proving_ground", "--run", run, "--endpoint", f"tcp/127.0.0.1:{self.link.port}", "--drive",
                "--clock", "clock", "--course-topic", "/course", "--speed", str(speed),
                "--record", str(self.recording)]  # fmt: skip
        self._programs = [begun(simulator, folder / "simulate.txt"), begun(live, folder / "live.txt")]

    @property
    def runs(self) -> bool:
        """Whether both programs run: the simulator ends with the course."""
        return all(program.poll() is None for program in self._programs)

    @property
    def now(self) -> float:
        """The steady clock, by which all is heard [s]."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Let it run for some time [s]."""
        time.sleep(seconds)

    def drives(self, seconds: float) -> bool:
        """Whether commands flow, and none of them is a stop, for a second, within some time [s]."""
        since = None
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.runs:
            time.sleep(0.05)
            now = time.monotonic()
            recent = [command for command in self._commands[-50:] if now - command[0] < 0.3]
            driving = bool(recent) and not any(_is_stop(*command[1:]) for command in recent)
            since = (since or now) if driving else None
            if since is not None and now - since > _FOR:
                return True
        return False

    def stopped_after(self, moment: float) -> float:
        """Time from a moment until a stop was heard [s]; NaN where none was."""
        return next((c[0] - moment for c in self._commands if c[0] >= moment and _is_stop(*c[1:])), np.nan)

    @property
    def mode(self) -> str:
        """What was said last."""
        return self._modes[-1][1] if self._modes else ""

    def why(self, moment: float) -> str:
        """Why it was first stopped after a moment [s], as control says; empty where it did not."""
        return next((mode for at, mode in self._modes if at >= moment and mode.startswith("stop")), "")

    def new_lines(self, moment: float) -> set[str]:
        """Lines of the diagnostics since a moment that were not there before."""
        before = [lines for at, lines in self._diagnostics if at < moment]
        after = [lines for at, lines in self._diagnostics if at >= moment]
        return set().union(*after) - (before[-1] if before else frozenset())

    def end(self) -> None:
        """End both as Ctrl-C does."""
        ended(*reversed(self._programs))
        self.session.close()
        self.link.close()
        self.router.kill()

    def _subscribe(self) -> None:
        hear = self.session.subscribe
        hear(COMMAND, self._decoded(self._commanded), msgtype="sensor_msgs/msg/Joy")
        hear("/diagnostics", self._decoded(self._diagnosed), msgtype="diagnostic_msgs/msg/DiagnosticArray")
        hear("/offpiste/mode", self._decoded(self._moded), msgtype="std_msgs/msg/String", history=True)
        hear(ODOMETRY, self._kept, msgtype="nav_msgs/msg/Odometry")

    def _decoded(self, take: Callable[[Any], None]) -> Callable[[Received], None]:
        def deliver(received: Received) -> None:
            message = self.session.decode(received)
            if message is not None and received.publisher[:8] != self.session.identity:
                take(message)

        return deliver

    def _commanded(self, message: Any) -> None:
        self._commands.append((time.monotonic(), float(message.axes[0]), float(message.axes[1])))

    def _diagnosed(self, message: Any) -> None:
        lines: list[str] = []
        for status in message.status:
            name = status.name.removeprefix("offpiste: ")
            lines.append(f"{name}: {status.message}")
            for value in status.values:
                if value.key == "pid":
                    self.pids[name] = int(value.value)
                if value.key.startswith(("restarts", "dropped", "refused", "unusable")):
                    lines.append(f"{name}: {value.key} = {value.value}")
        self._diagnostics.append((time.monotonic(), frozenset(lines)))

    def _moded(self, message: Any) -> None:
        self._modes.append((time.monotonic(), message.data))

    def _kept(self, received: Received) -> None:
        self.last_odometry = received


def _is_stop(throttle: float, brake: float) -> bool:
    """Whether a command is the stop, whose brake no plan has to the digit."""
    return throttle == 0.0 and abs(brake - RuntimeSettings().stop) < 1e-6
