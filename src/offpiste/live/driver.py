"""A vehicle driven in one process, step by step of a clock: the same messages give the same commands, to the bit.

Lockstep over the transport, the replay of a log, and the tests that compare them use it.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from offpiste.core.channels import all_actuators
from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError
from offpiste.live.command_messages import Command
from offpiste.live.gate import Gate, Passed
from offpiste.live.reception import Pressed, Reception, Taken
from offpiste.live.sensor_messages import Sensors
from offpiste.logs.measurements import Cloud, Image
from offpiste.logs.ros.bag_files import heard_at
from offpiste.perception.camera import make_pinhole_camera
from offpiste.planning.course import Course, CourseTracker
from offpiste.rig.outputs import can_reverse
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.modes import Controls
from offpiste.runtime.perception import SensorSetup
from offpiste.runtime.planner import Planner
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.settings import RuntimeSettings


class Heard(NamedTuple):
    """A decoded message, when it came [s], and who published it, as far as the transport says so."""

    topic: str
    message: Any
    received: float
    publisher: bytes = b""


@dataclass(frozen=True)
class Step:
    """What a step came to.

    Attributes:
        controls: of the run time.
        command: what is sent where commands are; what would be, in shadow mode.
        why: why the gate made it a stop.
    """

    controls: Controls
    command: Command
    why: str


class StepDriver:
    """Takes messages, and commands once a step.

    Args:
        shadow: someone else drives: plans are made from their commands, as far as the rig's channels have them.
        seed: of the sampled controls.

    Attributes:
        runtime: None until all that it needs was heard.
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
        refuse_unmeasured(planner, rig)
        self._rig, self._planner, self._reception = rig, planner, reception
        self._settings, self._shadow, self._seed = settings or RuntimeSettings(), shadow, seed
        # In shadow mode nothing is sent: no switch has to be pressed for a look at what would be.
        self._gate = Gate(rig.live.limits, None if shadow else rig.live.enable, self._settings.stop)
        self._now = -np.inf
        self.runtime: Runtime | None = None

    def step(self, heard: Iterable[Heard], now: float) -> Step | None:
        """Messages that came since the last step, and the command for the next `conventions.DT`.

        Args:
            now: time [s].

        Returns:
            None while something is missing that driving needs.
        """
        if now < self._now:
            self._gate.restart(now)
        self._now = now
        for topic, message, received, publisher in self._in_order(heard):
            for taken in self._reception.take(topic, message, received):
                if isinstance(taken, Pressed):
                    self._gate.enabled(taken.pressed, now, age=taken.age, publisher=publisher)
                self._pass_on(taken)
        if self.runtime is None:
            return None
        passed: list[Passed] = []

        def applied(controls: Controls) -> np.ndarray:
            passed.append(self._passed(controls, now))
            return passed[-1].control

        if self._shadow:  # who drives need not complete our stops
            self.runtime.follower.stopping = False
            self.runtime.follower.driver = self._reception.vehicle.given(now)
        held = "" if self._shadow else self._gate.blocked(now)
        controls = self.runtime.step(now, applied, held)
        followed = self.runtime.prediction_at(now) if controls.mode in ("driving", "degraded") else None
        stopped = passed[-1].why != ""
        command = Command(now, passed[-1].control, controls.gear, None if stopped else followed)
        return Step(controls, command, passed[-1].why)

    def other(self, now: float) -> None:
        """Another publisher commanded the vehicle [s]."""
        if not self._shadow:
            self._gate.other(now)

    @property
    def stop(self) -> Command:
        """The stop, with the steering that was sent last."""
        control = np.array((0.0, self._settings.stop, self._gate.steer))
        gear = self._settings.gear if self.runtime is None else self.runtime.follower.gear
        return Command(max(self._now, 0.0), control, gear)

    def _in_order(self, heard: Iterable[Heard]) -> list[Heard]:
        """The vehicle's messages by their stamps, the position last of those of one stamp; then all others."""
        vehicle = self._reception.vehicle

        def order(one: Heard) -> tuple[bool, float, bool]:
            if one.topic not in vehicle.topics:
                return True, 0.0, False
            stamp = heard_at(one.received, one.message, self._rig.clock.stamps)
            return False, -math.inf if math.isnan(stamp) else stamp, one.topic == vehicle.position_topic

        return sorted(heard, key=order)

    def _pass_on(self, taken: Taken) -> None:
        if self.runtime is None:
            sensors, course = self._reception.sensors.sensors, self._reception.course
            if sensors is None or course is None:
                return
            setup = sensor_setup_of(self._planner, sensors)
            wheels = self._rig.wheel_positions()
            self.runtime = Runtime(
                self._planner.dynamics, setup, wheels, course, self._settings,
                seed=self._seed, spread=self._planner.spread,
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

    def _passed(self, controls: Controls, now: float) -> Passed:
        assert self.runtime is not None
        stopping = controls.mode in ("stopping", "stopped")
        return self._gate.passed(controls.command, self.runtime.follower.speed, now, stopping=stopping)


def sensor_setup_of(planner: Planner, sensors: Sensors) -> SensorSetup:
    """Sensors of a robot as a planner's run time reads them."""
    cameras, lidars = sensors
    if planner.extractor is None:
        return SensorSetup(lidars)
    patch = planner.extractor.patch
    pinholes = {name: make_pinhole_camera(camera, patch) for name, camera in cameras.items()}
    return SensorSetup(lidars, pinholes, planner.extractor.extract)


def refuse_unmeasured(planner: Planner, rig: Rig) -> None:
    """Refuse a model that reads what the robot does not measure: it would wait for it forever.

    Raises:
        LiveError: it reads the simulator's own ground, actuators that the rig lacks, or images without cameras.
    """
    if planner.knows_ground:
        how = "give a run trained on visual features, or on none"
        raise LiveError("reads the ground's true properties, which no robot has", where=planner.folder, how=how)
    lacks = [name for name in planner.dynamics.vehicle.actuators if name not in rig.present_actuators]
    if lacks:
        known = {actuator.name: actuator for actuator in all_actuators()}
        needed = dict.fromkeys(known[known[name].rate_of or name].channel for name in lacks)
        how = f"add {', '.join(f'[channels.{name}]' for name in needed)} to the rig, or give a run trained without them"
        what = f"the model reads {', '.join(lacks)}, which rig '{rig.name}' does not have"
        raise LiveError(what, where=planner.folder, how=how)
    if planner.extractor is not None and not rig.cameras:
        how = "add its cameras to the rig, or give a run that reads no images"
        raise LiveError(f"the model reads images, and rig '{rig.name}' has no cameras", where=planner.folder, how=how)


STEP_NS = round(DT * 1e9)
"""Time from step to step [ns]."""
