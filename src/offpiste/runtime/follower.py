"""Schedule of plans, and the control that is due: from the acting plan or from a controlled stop.

This part of the run time runs at 50 Hz independently of the others and needs neither a map nor a model.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT
from offpiste.planning.mppi import shift
from offpiste.runtime.course_tracker import CourseTracker
from offpiste.runtime.estimator import Given, TrackRows, VehicleTrack
from offpiste.runtime.modes import NO_AGES, Ages, Controls, Event, ModeDecision, decide_mode
from offpiste.runtime.settings import RuntimeSettings

Applied = Callable[[Controls], Float[np.ndarray, " 3"]]
"""From a command to the control that the vehicle is given, which limits may make another one."""


@dataclass(frozen=True)
class TimedPlan:
    """A plan and the time at which it acts.

    Attributes:
        start: when its first control is commanded [s].
        made: when it was made [s].
        controls: one for each step of `conventions.DT`.
        gear: gear of the plan: 1 forward, -1 reverse.
    """

    start: float
    made: float
    controls: Float[Tensor, "T 3"]
    gear: float = 1.0


class Schedule:
    """Plans in the order of their starts; each replaces the one before it from its start."""

    def __init__(self) -> None:
        self._plans: deque[TimedPlan] = deque()

    @property
    def latest(self) -> TimedPlan | None:
        """Most recent plan; None before the first."""
        return self._plans[-1] if self._plans else None

    def add(self, plan: TimedPlan) -> None:
        """Add a plan; it must not start before the plans in the schedule."""
        self._plans.append(plan)

    def clear(self) -> None:
        """Forget all plans."""
        self._plans.clear()

    def acting(self, time: float) -> TimedPlan | None:
        """Plan that acts at `time` [s], dropping the plans before it; None before the first."""
        while len(self._plans) > 1 and self._plans[1].start <= time + 1e-6:
            self._plans.popleft()
        return self._plans[0] if self._plans and self._plans[0].start <= time + 1e-6 else None

    def at(self, time: float) -> TimedPlan | None:
        """Plan that acts at a present or future `time` [s]; None before the first."""
        return next((p for p in reversed(self._plans) if p.start <= time + 1e-6), None)

    def control(self, time: float) -> Float[np.ndarray, " 3"] | None:
        """Control at `time` [s]; the last control of a plan is held. None before the first plan."""
        plan = self.at(time)
        return None if plan is None else plan.controls[_step(plan, time)].numpy().astype(np.float64)

    def committed(self, now: float, steps: int, otherwise: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "steps 3"]:
        """Controls of the next steps from the plans made so far.

        Args:
            otherwise: control used until the first plan acts.
        """
        due = (self.control(now + DT * step) for step in range(steps))
        return np.array([otherwise if control is None else control for control in due]).reshape(steps, 3)

    def continued(
        self, start: float, steps: int, rest: Float[np.ndarray, " 3"], gear: float = 1.0
    ) -> Float[Tensor, "steps 3"]:
        """Latest plan from `start` on [s], its last control held: the initial guess of the next plan.

        Args:
            rest: control of all steps if there is no plan in this gear.
            gear: of the next plan.
        """
        if self.latest is None or self.latest.gear != gear:
            return torch.as_tensor(rest, dtype=torch.float32).repeat(steps, 1)
        return continued(self.latest, start)


def continued(plan: TimedPlan, start: float) -> Float[Tensor, "T 3"]:
    """Plan from `start` on [s], its last control held."""
    return shift(plan.controls, max(round((start - plan.start) / DT), 0))


def _step(plan: TimedPlan, time: float) -> int:
    return min(max(int((time - plan.start) / DT + 1e-4), 0), len(plan.controls) - 1)


@dataclass(frozen=True)
class MapState:
    """What a mode depends on of the map.

    Attributes:
        scan_time, image_time: of the last scan and image in it [s]; infinite for models without visual features.
        empty: whether it holds no ground within reach of a plan.
        stuck: whether the planner gave up getting the vehicle out of a place.
    """

    scan_time: float = -np.inf
    image_time: float = -np.inf
    empty: bool = False
    stuck: bool = False


class Follower:
    """Follows plans, and stops where inputs are missing.

    Args:
        track: readings of the vehicle, and commands, which are added to it.
        tracker: position along the course; another course has another one.

    Attributes:
        schedule: plans that were made.
        gear: that is commanded: 1 forward, -1 reverse.
        stopping: whether a stop has begun and is not completed.
        driver: what another driver gives the vehicle; plans begin from it as far as it is heard.
        events: changes of mode, oldest first.
    """

    def __init__(self, settings: RuntimeSettings, track: VehicleTrack, tracker: CourseTracker) -> None:
        self._settings, self._track = settings, track
        self.tracker, self.schedule, self.gear = tracker, Schedule(), settings.gear
        self.stopping, self.driver = False, Given()
        self.events: list[Event] = []

    def mode(self, now: float, state: MapState, least: Ages = NO_AGES) -> ModeDecision:
        """Mode that the ages of the inputs demand.

        Args:
            least: ages by another clock than that of the stamps; the greater ones count.
        """
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
        """Controls for the next `conventions.DT`: of the plan, or of a controlled stop.

        A stop that has begun is completed before the vehicle drives away again.

        Args:
            applied: gives the control that the vehicle is then given, unless another drives; None where it is the one
                that is commanded.
        """
        controls = self._due(now, decision)
        control = controls.command if applied is None else applied(controls)
        self._track.commanded(now, *self.driver.instead_of(control, controls.gear))
        if not self.events or (controls.mode, controls.why) != (self.events[-1].mode, self.events[-1].why):
            self.events.append(Event(now, controls.mode, controls.why))
        return controls

    def _due(self, now: float, decision: ModeDecision) -> Controls:
        planned = self.schedule.control(now)
        at_standstill = self.at_standstill()
        must_stop = decision.mode == "stopping" or planned is None
        if not must_stop and not (self.stopping and not at_standstill):
            self.stopping = False
            assert planned is not None
            return self._driven(now, planned, decision)
        self.stopping = True
        # The planned steering is kept: straight ahead may lead off the course.
        steer = 0.0 if planned is None else float(planned[2])
        command = np.array((0.0, self._settings.stop, steer))
        why = decision.why if must_stop or not self.events else self.events[-1].why
        return Controls(now, command, "stopped" if at_standstill else "stopping", why, self.gear)

    def _driven(self, now: float, planned: Float[np.ndarray, " 3"], decision: ModeDecision) -> Controls:
        """The plan's control; before it, while the plan is in another gear, the brake until that can be engaged."""
        if self._shifts(now):
            planned[:2] = (0.0, self._settings.stop)
            if self.at_standstill():
                self.gear = -self.gear
        why = decision.why or ("backing out" if self.gear < 0 else "")
        return Controls(now, planned, decision.mode, why, self.gear)

    def _shifts(self, time: float) -> bool:
        """Whether the plan that acts at a moment [s] is in another gear than is engaged."""
        plan = self.schedule.at(time)
        return plan is not None and plan.gear != self.gear

    def committed(self, first: float, start: float, rows: TrackRows) -> Float[np.ndarray, "L 3"]:
        """Controls committed from the last reading until a new plan acts; another driver's last one is held.

        Args:
            first, start: times of the two [s].
            rows: up to the last reading.
        """
        latest = self.schedule.latest
        if latest is not None and first - latest.start > self._settings.forget:
            self.schedule.clear()
        stop = np.array((0.0, self._settings.stop, 0.0))
        steps = max(round((start - first) / DT), 0)
        if self.driver.control is not None:
            return self._track.controls(first + DT * np.arange(steps))[0]
        committed = self.schedule.committed(first, steps, stop if self.stopping else rows.control[-2])
        # Steering follows the plan, the pedals do not.
        halts = self.stopping and not self.at_standstill()
        braked = [halts or self._shifts(first + DT * step) for step in range(steps)]
        committed[braked, :2] = stop[:2]
        return committed

    @property
    def engaged(self) -> float:
        """Gear until a new plan acts: the one that is commanded, or another driver's."""
        return self.gear if self.driver.gear is None else self.driver.gear

    @property
    def speed(self) -> float:
        """Speed over the ground by the last reading [m/s]; infinite before the first."""
        latest = self._track.latest
        return np.inf if latest is None else float(np.hypot(*latest.velocity[:2]))

    def at_standstill(self) -> bool:
        """Whether the vehicle is at a standstill."""
        return self.speed < self._settings.standstill

    def restart(self) -> None:
        """Forget all plans; the vehicle may be anywhere on its course."""
        self.schedule.clear()
        self.tracker.lose()
