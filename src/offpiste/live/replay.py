"""Replay of a recorded drive to the run time in one process: equal messages give equal commands, to the bit."""

import csv
import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError
from offpiste.core.files import write_text
from offpiste.core.progress import track
from offpiste.live.command_messages import Command
from offpiste.live.gate import Gate
from offpiste.live.play import RecordedDrive
from offpiste.live.reception import Pressed, Reception, Taken
from offpiste.live.session import LiveSettings
from offpiste.logs.measurements import Cloud, Image
from offpiste.logs.ros.bag_files import heard_at
from offpiste.planning.course import Course, CourseTracker
from offpiste.rig.outputs import can_reverse
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.modes import Controls
from offpiste.runtime.planner import Planner
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.settings import RuntimeSettings
from offpiste.transport.message_types import MessageTypes

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Step:
    """Result of a step: controls of the run time, the command after the gate, and the gate's reason for a stop."""

    controls: Controls
    command: Command
    why: str


class StepDriver:
    """Step the run time on messages of a robot.

    Args:
        shadow: another driver commands the vehicle; plans start from those commands if the rig has their channels.
        seed: of the sampled controls.

    Attributes:
        runtime: None until all required messages have arrived.
    """

    def __init__(
        self,
        rig: Rig,
        planner: Planner,
        reception: Reception,
        settings: RuntimeSettings | None = None,
        *,
        shadow: bool = True,
        seed: int = 0,
    ) -> None:
        self._rig, self._planner, self._reception = rig, planner, reception
        self._settings, self._shadow, self._seed = settings or RuntimeSettings(), shadow, seed
        # Shadow mode sends nothing and needs no switch.
        self._gate = Gate(rig.live.limits, None if shadow else rig.live.enable, self._settings.stop)
        self.runtime: Runtime | None = None

    def step(self, messages: Iterable[tuple[str, Any]], now: float) -> Step | None:
        """Take the messages since the last step, by topic; return the result, or None while a message is missing."""
        for topic, message in self._in_order(messages, now):
            for taken in self._reception.take(topic, message, now):
                if isinstance(taken, Pressed):
                    self._gate.enabled(taken.pressed, now, age=taken.age)
                self._pass_on(taken)
        if (runtime := self.runtime) is None:
            return None

        def applied(controls: Controls) -> np.ndarray:
            stopping = not controls.drives
            return self._gate.check(controls.command, runtime.follower.speed, now, stopping=stopping).control

        if self._shadow:  # another driver need not complete our stops
            runtime.follower.stopping = False
            runtime.follower.driver = self._reception.vehicle.given(now)
        held = "" if self._shadow else self._gate.blocked(now)
        controls = runtime.step(now, applied, held)
        checked, acting = self._gate.checked, runtime.follower.schedule.at(now)
        followed = acting.prediction if acting is not None and controls.drives and not checked.why else None
        return Step(controls, Command(now, checked.control, controls.gear, followed), checked.why)

    def _in_order(self, messages: Iterable[tuple[str, Any]], now: float) -> list[tuple[str, Any]]:
        """Sort vehicle messages by stamp, with the position last at equal stamps, before all others."""
        vehicle = self._reception.vehicle

        def order(given: tuple[str, Any]) -> tuple[bool, float, bool]:
            topic, message = given
            if topic not in vehicle.topics:
                return True, 0.0, False
            stamp = heard_at(now, message, self._rig.clock.stamps)
            return False, -math.inf if math.isnan(stamp) else stamp, topic == vehicle.position_topic

        return sorted(messages, key=order)

    def _pass_on(self, taken: Taken) -> None:
        if self.runtime is None:
            sensors, course = self._reception.sensors.sensors, self._reception.course
            if sensors is None or course is None:
                return
            self.runtime = Runtime(
                self._planner.dynamics, self._planner.sensor_setup(*sensors), self._rig.wheel_positions(), course,
                self._settings, seed=self._seed, spread=self._planner.spread,
                reverses=not self._shadow and can_reverse(self._rig.outputs),
            )  # fmt: skip
        if isinstance(taken, VehicleReading):
            self.runtime.vehicle(taken)
        elif isinstance(taken, Image):
            self.runtime.image(taken)
        elif isinstance(taken, Cloud):
            self.runtime.scan(taken)
        elif isinstance(taken, Course):
            self.runtime.follower.tracker = CourseTracker(taken)


def replayed(drive: RecordedDrive, driver: StepDriver, types: MessageTypes) -> Iterator[tuple[float, Step | None]]:
    """Yield the time [s] and result of each step; messages that cannot be decoded are dropped."""
    for step in drive.steps():
        now = step.time / 10**9
        decoded = [(one.topic, types.decoded(one.type, one.data)) for one in step.messages]
        yield now, driver.step([(topic, message) for topic, message in decoded if message is not None], now)


def replay_log(
    settings: LiveSettings, rig: Rig, planner: Planner, reception: Reception, types: MessageTypes, log: Path,
    table: Path | None,
) -> None:  # fmt: skip
    """Replay a log, and write all commands to a table (.csv); raises `LiveError` if planning was never possible."""
    driver = StepDriver(rig, planner, reception, settings.runtime, shadow=not settings.drive, seed=settings.seed)
    drive = RecordedDrive(log, rig, tuple(reception.topics))
    steps = replayed(drive, driver, types)
    total, text = round(min(drive.seconds, settings.seconds) / DT), StringIO(newline="")
    rows = csv.writer(text)
    rows.writerow(("time", "throttle", "brake", "steer", "mode", "why"))
    try:
        for _, (now, step) in zip(track(range(total + 1), f"replay {log.name}"), steps, strict=False):
            if step is not None:
                control = (repr(float(value)) for value in step.command.control)
                rows.writerow((repr(now), *control, step.controls.mode, step.controls.why or step.why))
    finally:
        if table is not None and driver.runtime is not None:
            write_text(table, text.getvalue())
    if driver.runtime is None:
        what = f"planning was never possible: the log lacks {reception.waiting_for}"
        raise LiveError(what, where=log, how="see docs/live.md")
    for name in reception.sensors.left_out:
        logger.warning(f"optional sensor {name} was left out: it was first heard after the setup of the others")
