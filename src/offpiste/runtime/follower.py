"""Schedule of plans, and the current control from the acting plan or a controlled stop.

It runs at 50 Hz, independently of the rest, and needs neither a map nor a model.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT
from offpiste.planning.course import CourseTracker
from offpiste.planning.mppi import shift
from offpiste.runtime.estimator import Given, TrackRows, VehicleTrack
from offpiste.runtime.modes import NO_AGES, Ages, Controls, Event, ModeDecision, decide_mode
from offpiste.runtime.prediction import Prediction
from offpiste.runtime.settings import RuntimeSettings

Applied = Callable[[Controls], Float[np.ndarray, " 3"]]
"""Function from a command to the control that is sent after limits."""


@dataclass(frozen=True)
class TimedPlan:
    """A plan with its times and its predicted trajectory."""

    start: float  # time of its first control [s]
    made: float  # time at which it was made [s]
    controls: Float[Tensor, "T 3"]  # at steps of `conventions.DT`
    prediction: Prediction
    gear: float = 1.0  # 1 forward, -1 reverse

    def at(self, time: float) -> Float[np.ndarray, " 3"]:
        """Return the control at `time` [s]; the last one is held."""
        step = min(max(int((time - self.start) / DT + 1e-4), 0), len(self.controls) - 1)
        return self.controls[step].numpy().astype(np.float64)

    def continued(self, start: float) -> Float[Tensor, "T 3"]:
        """Return the controls from `start` [s] on, the last one held."""
        return shift(self.controls, max(round((start - self.start) / DT), 0))


class Schedule:
    """Plans in the order of their starts; each replaces the one before it from its start on."""

    def __init__(self) -> None:
        self._plans: deque[TimedPlan] = deque()

    @property
    def latest(self) -> TimedPlan | None:
        """Most recent plan; None before the first."""
        return self._plans[-1] if self._plans else None

    def add(self, plan: TimedPlan) -> None:
        """Add a plan that does not start before those in the schedule."""
        self._plans.append(plan)

    def clear(self) -> None:
        """Delete all plans."""
        self._plans.clear()

    def acting(self, time: float) -> TimedPlan | None:
        """Return the plan that acts at `time` [s], and delete those before it; None before the first."""
        while len(self._plans) > 1 and self._plans[1].start <= time + 1e-6:
            self._plans.popleft()
        return self.at(time)

    def at(self, time: float) -> TimedPlan | None:
        """Return the plan that acts at a present or future `time` [s]; None before the first."""
        return next((p for p in reversed(self._plans) if p.start <= time + 1e-6), None)

    def control(self, time: float) -> Float[np.ndarray, " 3"] | None:
        """Return the control at `time` [s]; the last control of a plan is held. None before the first plan."""
        plan = self.at(time)
        return None if plan is None else plan.at(time)


@dataclass(frozen=True)
class MapState:
    """State of map and planner for the choice of the mode."""

    scan_time: float = -np.inf  # stamp of the last scan [s]
    image_time: float = -np.inf  # stamp of the last image [s]; infinite for models without visual features
    empty: bool = False  # whether no ground is within reach of a plan
    stuck: bool = False  # whether backing out was given up


class Follower:
    """Follows plans, and stops if inputs are missing.

    Args:
        track: readings of the vehicle; commands are added to it.
        tracker: position along the course.

    Attributes:
        gear: commanded gear, 1 forward, -1 reverse.
        stopping: whether a stop is in progress.
        driver: control and gear of another driver, from which plans start if received.
        events: changes of mode, oldest first.
    """

    def __init__(self, settings: RuntimeSettings, track: VehicleTrack, tracker: CourseTracker) -> None:
        self._settings, self._track = settings, track
        self.tracker, self.schedule, self.gear = tracker, Schedule(), settings.gear
        self.stopping, self.driver = False, Given()
        self.events: list[Event] = []

    def mode(self, now: float, state: MapState, least: Ages = NO_AGES) -> ModeDecision:
        """Return the mode for the ages of the inputs; those by another clock than that of the stamps are `least`."""
        latest, followed = self._track.latest, self.schedule.acting(now)
        ages = Ages(
            state=now - (latest.time if latest else -np.inf),
            scan=now - state.scan_time,
            image=now - state.image_time,
            plan=now - followed.start if followed else np.inf,
        )
        finished = self.tracker.progress > self.tracker.length - self._settings.arrived
        faults = {"map_empty": state.empty, "finished": finished, "stuck": state.stuck}
        return decide_mode(ages.at_least(least), self._settings.timeouts, **faults)

    def follow(self, now: float, decision: ModeDecision, applied: Applied | None = None) -> Controls:
        """Return the controls of the plan, or of a controlled stop, for the next `conventions.DT`.

        A stop is completed before the vehicle drives again.

        Args:
            applied: function that returns the control after limits; None if the command is sent unchanged.
        """
        controls = self._due(now, decision)
        control = controls.command if applied is None else applied(controls)
        self._track.commanded(now, *self.driver.instead_of(control, controls.gear))
        if not self.events or (controls.mode, controls.why) != (self.events[-1].mode, self.events[-1].why):
            self.events.append(Event(now, controls.mode, controls.why))
        return controls

    def _due(self, now: float, decision: ModeDecision) -> Controls:
        """Return the planned control, the brake of a stop, or the brake until the gear of the plan can be engaged."""
        planned, standing = self.schedule.control(now), self.at_standstill()
        must_stop = decision.mode == "stopping" or planned is None
        self.stopping = must_stop or (self.stopping and not standing)
        # A stop keeps the planned steering, since straight ahead may lead off the course.
        command = np.zeros(3) if planned is None else planned
        if self.stopping or self._shifts(now):
            command[:2] = (0.0, self._settings.stop)
        if self.stopping:
            why = decision.why if must_stop or not self.events else self.events[-1].why
            return Controls(now, command, "stopped" if standing else "stopping", why, self.gear)
        if self._shifts(now) and standing:
            self.gear = -self.gear
        why = decision.why or ("backing out" if self.gear < 0 else "")
        return Controls(now, command, decision.mode, why, self.gear)

    def _shifts(self, time: float) -> bool:
        """Return whether the plan that acts at a time [s] needs another gear."""
        plan = self.schedule.at(time)
        return plan is not None and plan.gear != self.gear

    def committed(self, first: float, start: float, rows: TrackRows) -> Float[np.ndarray, "L 3"]:
        """Return the controls committed from the last reading until a new plan acts; another driver's control is held.

        Args:
            first, start: times of the last reading and of the new plan [s].
            rows: rows up to the last reading.
        """
        latest = self.schedule.latest
        if latest is not None and first - latest.start > self._settings.forget:
            self.schedule.clear()
        times = first + DT * np.arange(max(round((start - first) / DT), 0))
        if self.driver.control is not None:
            return self._track.controls(times)[0]
        stop = np.array((0.0, self._settings.stop, 0.0))
        halts, committed = self.stopping and not self.at_standstill(), np.empty((len(times), 3))
        for step, time in enumerate(times.tolist()):
            planned = self.schedule.control(time)
            # Until the first plan acts, the last control is held; braking replaces the pedals of a plan alone.
            committed[step] = planned if planned is not None else stop if self.stopping else rows.control[-2]
            if halts or self._shifts(time):
                committed[step, :2] = stop[:2]
        return committed

    @property
    def engaged(self) -> float:
        """Gear until a new plan acts: commanded, or of another driver."""
        return self.gear if self.driver.gear is None else self.driver.gear

    @property
    def speed(self) -> float:
        """Speed over ground in the last reading [m/s]; infinite before the first."""
        latest = self._track.latest
        return np.inf if latest is None else float(np.hypot(*latest.velocity[:2]))

    def at_standstill(self) -> bool:
        """Return whether the vehicle is at a standstill."""
        return self.speed < self._settings.standstill

    def restart(self) -> None:
        """Delete all plans; the vehicle may be anywhere on its course."""
        self.schedule.clear()
        self.tracker.lose()
