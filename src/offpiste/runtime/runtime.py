"""The paper's on-line pipeline as one object: sensor messages in, controls out.

Images -> backbone -> PCA -> encoder -> projection on scans -> map -> MPPI. Time comes from stamps only: the same
messages give the same controls, however long they take to compute. A plan made from data at t acts from t + latency;
it starts from the state that the model predicts through the controls committed until then.
"""

from collections import deque
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float

from offpiste.compilation import single_threaded_torch
from offpiste.conventions import ACTUATORS, DT, HORIZON_STEPS
from offpiste.dynamics.base import Dynamics
from offpiste.errors import PlanningError
from offpiste.logs.measurements import Cloud, Image
from offpiste.planning.cost_map import cost_map
from offpiste.planning.course import Course
from offpiste.planning.driving_cost import Situation
from offpiste.planning.pedal import controls_of
from offpiste.runtime.course_tracker import CourseTracker
from offpiste.runtime.estimator import TrackRows, VehicleReading, VehicleTrack
from offpiste.runtime.modes import Ages, Controls, Event, ModeDecision, decide_mode
from offpiste.runtime.perception import OnlineMapper, SensorSetup, Stopwatch
from offpiste.runtime.plan_improvement import PlanImprover
from offpiste.runtime.prediction import (
    Area,
    KnownGround,
    Prediction,
    coded_area,
    cropped,
    model_state_after,
    model_state_of,
    predicted,
)
from offpiste.runtime.schedule import Launch, Schedule, TimedPlan
from offpiste.runtime.settings import RuntimeSettings
from offpiste.state import ModelState


class Runtime:
    """Drives a vehicle along a course, from messages of its sensors.

    Args:
        dynamics: model that plans are made with; it is set to evaluation mode, without gradients.
        wheels: positions in the body frame, from the pose point [m].
        ground: ground-truth features, used instead of features from cameras.
        seed: seed of the sampled controls.

    Attributes:
        course_tracker: position along the course.
        watch: wall-clock times of the stages.
        events: changes of mode, oldest first.
        failures: reasons of plans that failed.

    Raises:
        PlanningError: the model reads features, and nothing extracts them; or no GPU kernels can step it.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        sensors: SensorSetup,
        wheels: Float[np.ndarray, "4 2"],
        course: Course,
        settings: RuntimeSettings | None = None,
        *,
        ground: KnownGround | None = None,
        seed: int = 0,
    ) -> None:
        self._settings = settings or RuntimeSettings()
        self._dynamics = dynamics.eval().requires_grad_(False)
        self._encoder = dynamics.encoder
        self._ground = ground
        if self._encoder is not None and ground is None and sensors.extract is None:
            raise PlanningError(
                "the model reads features, and nothing extracts them", how="give SensorSetup(…, extract=…)"
            )
        self._needed = np.isin(ACTUATORS, dynamics.vehicle.actuators)
        self._wheels = torch.as_tensor(wheels, dtype=torch.float32)
        self._improver = PlanImprover(self._dynamics, self._settings, seed)
        self.watch = Stopwatch()
        self.course_tracker = CourseTracker(course)
        self._track, self._schedule = VehicleTrack(), Schedule()
        self._launch = Launch(self._settings.launch)
        encoder = None if ground is not None else self._encoder
        self._mapper = OnlineMapper(sensors, encoder, self._track, self._settings.replay, self.watch)
        self._now, self._plan_due, self._map_empty, self._stopping = np.inf, -np.inf, False, False
        self._predictions: deque[Prediction] = deque(maxlen=round(self._settings.remember * self._settings.plan_rate))
        self.events: list[Event] = []
        self.failures: list[str] = []

    @property
    def predictions(self) -> list[Prediction]:
        """Predicted trajectories of the last plans, oldest first."""
        return list(self._predictions)

    @property
    def dropped(self) -> dict[str, int]:
        """Number of messages that were dropped, by reason."""
        return dict(self._mapper.dropped)

    def vehicle(self, reading: VehicleReading) -> None:
        """Add a reading of the vehicle; one that cannot be used is dropped and counted (`dropped`)."""
        latest = self._track.latest
        if self._ahead("readings of the vehicle", reading.time):
            return
        if not reading.finite or not np.isfinite(reading.actuators[self._needed]).all():
            self._mapper.dropped["readings of the vehicle that are not finite"] += 1
        elif latest is not None and reading.time <= latest.time:
            self._mapper.dropped["readings of the vehicle whose stamps repeat or go back"] += 1
        else:
            if self._track.add(reading):
                self._mapper.restart()
            self.course_tracker.move(reading.position[:2])

    def image(self, image: Image) -> None:
        """Add an image."""
        if not self._ahead(image.camera, image.time):
            self._mapper.image(image)

    def scan(self, scan: Cloud) -> None:
        """Add a scan."""
        if not self._ahead(scan.lidar, scan.time):
            self._mapper.scan(scan)

    def forget_map(self) -> None:
        """Begin an empty map."""
        self._mapper.restart()

    @torch.no_grad()
    def command(self, now: float) -> Controls:
        """Controls for the next `conventions.DT`, to be called that often.

        If the clock goes back, poses, map and plans are forgotten.
        """
        if now < self._now < np.inf:
            self._restart()
            self.events.append(Event(now, "stopping", "the clock went back"))
        self._now = now
        decision = self._current_mode(now)
        if now >= self._plan_due - 1e-6:
            self._plan_due = now + 1 / self._settings.plan_rate
            if decision.mode != "stopping" or decision.why in ("no plan", "empty map"):
                with single_threaded_torch():
                    self._plan(now, decision)
                decision = self._current_mode(now)
        controls = self._follow(now, decision)
        self._track.commanded(now, controls.command)
        if not self.events or (controls.mode, controls.why) != (self.events[-1].mode, self.events[-1].why):
            self.events.append(Event(now, controls.mode, controls.why))
        return controls

    def _ahead(self, what: str, time: float) -> bool:
        """Whether a stamp is ahead of the clock, which is counted: after it, all later messages would count as old."""
        ahead = time > self._now + self._settings.timeouts.ahead
        if ahead:
            self._mapper.dropped[f"{what}: stamps ahead of the clock"] += 1
        return ahead

    def _restart(self) -> None:
        self._track.clear()
        self._schedule.clear()
        self._mapper.restart()
        self._launch.reset()
        self._plan_due = -np.inf

    def _current_mode(self, now: float) -> ModeDecision:
        mapper, latest, followed = self._mapper, self._track.latest, self._schedule.acting(now)
        ages = Ages(
            state=now - (latest.time if latest else -np.inf),
            scan=now - mapper.scan_time,
            image=now - mapper.image_time if mapper.uses_features else -np.inf,
            plan=now - followed.start if followed else np.inf,
        )
        finished = self.course_tracker.progress > self.course_tracker.length - self._settings.arrived
        return decide_mode(ages, self._settings.timeouts, map_empty=self._map_empty, finished=finished)

    def _follow(self, now: float, decision: ModeDecision) -> Controls:
        """Controls of the plan, or of a controlled stop.

        A stop that has begun is completed before the vehicle drives away again.
        """
        planned = self._schedule.control(now)
        at_standstill = self._at_standstill()
        must_stop = decision.mode == "stopping" or planned is None
        if not must_stop and not (self._stopping and not at_standstill):
            self._stopping = False
            assert planned is not None
            planned[0] = self._launch.throttle(float(planned[0]), self._speed)
            return Controls(now, planned, decision.mode, decision.why)
        self._stopping = True
        self._launch.reset()
        # The planned steering is kept: straight ahead may lead off the course.
        steer = 0.0 if planned is None else float(planned[2])
        command = np.array((0.0, self._settings.stop, steer))
        why = decision.why if must_stop or not self.events else self.events[-1].why
        return Controls(now, command, "stopped" if at_standstill else "stopping", why)

    @property
    def _speed(self) -> float:
        latest = self._track.latest
        return np.inf if latest is None else float(np.hypot(*latest.velocity[:2]))

    def _at_standstill(self) -> bool:
        return self._speed < self._settings.standstill

    def _plan(self, now: float, decision: ModeDecision) -> None:
        """Plan on the current map; if planning fails, the last plan stays."""
        settings, latest = self._settings, self._track.latest
        assert latest is not None
        layers = self._mapper.layers()
        rows = self._track.rows(latest.time)
        state = rows.state[-1]
        speed = max(float(np.hypot(*state[3:5])), self.course_tracker.target)
        half = 0.5 * speed * DT * HORIZON_STEPS
        heading = np.array((np.cos(state[2]), np.sin(state[2])))
        near = cropped(layers, state[:2] + half * heading, half + settings.margin)
        self._map_empty = not near.known.any()
        if self._map_empty:
            return
        with self.watch.of("encode map"):
            area = coded_area(near, self._encoder, self._ground)
        with self.watch.of("cost map"):
            stretch = self.course_tracker.stretch(at_most=settings.slow if decision.slow else np.inf)
            costs = cost_map(near, stretch, settings.hazards)
        with self.watch.of("start"):
            offset = torch.from_numpy(state[:2].copy())
            given = self._committed(latest.time, now + settings.latency, rows)
            committed = torch.as_tensor(given, dtype=torch.float32)
            last = committed[-1] if len(committed) else torch.as_tensor(rows.control[-2], dtype=torch.float32)
            model_state = model_state_of(self._dynamics, rows, area, self._wheels, offset, settings.gear)
            at = Situation(area.stack, costs, self._wheels, offset, model_state.state[0], last, settings.gear)
            model_state = model_state_after(self._dynamics, model_state, committed, area, at)
            at = replace(at, state=model_state.state[0])
        with self.watch.of("plan"):
            self._improve(now, area, model_state, at)

    def _committed(self, first: float, start: float, rows: TrackRows) -> Float[np.ndarray, "L 3"]:
        """Controls committed from the last reading until a new plan acts."""
        latest = self._schedule.latest
        if latest is not None and first - latest.start > self._settings.forget:
            self._schedule.clear()
        stop = np.array((0.0, self._settings.stop, 0.0))
        steps = max(round((start - first) / DT), 0)
        committed = self._schedule.committed(first, steps, stop if self._stopping else rows.control[-2])
        if self._stopping and not self._at_standstill():  # steering follows the plan, the pedals do not
            committed[:, :2] = stop[:2]
        else:
            committed[:, 0] = self._launch.ahead(committed[:, 0], self._speed)
        return committed

    def _improve(self, now: float, area: Area, model_state: ModelState, at: Situation) -> None:
        """Add a new plan and its prediction to the schedule; where none is finite, the last plan stays."""
        settings, model = self._settings, self._dynamics
        rest = controls_of(torch.tensor(settings.sampling.rest or (0.0, 0.0))).numpy()
        start = now + settings.latency
        before = self._schedule.continued(start, HORIZON_STEPS, rest)
        try:
            plan = self._improver.improve(before, model_state, area, at)
        except PlanningError as error:
            self.failures.append(str(error))
            return
        if not plan.controls.isfinite().all():
            self.failures.append("the plan is not finite")
            return
        controls = controls_of(plan.controls)
        self._schedule.add(TimedPlan(start, now, controls))
        states = predicted(model, model_state, controls, area, at, settings.weights)
        self._predictions.append(Prediction(start, states))
