"""The paper's on-line pipeline: sensor messages in, controls out.

Images -> backbone -> PCA -> encoder -> projection on scans -> map -> MPPI. Time is taken from stamps only: the same
messages give the same controls, however long the computation takes. A plan made from data at t acts from t + latency;
it starts from the state that the model predicts through the controls committed until then.
"""

from collections import deque
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float

from offpiste.core.errors import PlanningError
from offpiste.dynamics.base import Dynamics
from offpiste.logs.measurements import Cloud, Image
from offpiste.native.threads import single_threaded_torch
from offpiste.planning.course import Course, CourseTracker
from offpiste.runtime.estimator import Intake, VehicleReading, VehicleTrack
from offpiste.runtime.follower import Applied, Follower
from offpiste.runtime.modes import Controls, Event, ModeDecision
from offpiste.runtime.perception import OnlineMapper, SensorSetup, Stopwatch, encoder_on
from offpiste.runtime.plan_maker import PlanMaker
from offpiste.runtime.prediction import KnownGround, Prediction
from offpiste.runtime.settings import RuntimeSettings
from offpiste.uncertainty.spread import Spread


class Runtime:
    """Drives a vehicle along a course.

    Args:
        dynamics: model for planning; it is set to evaluation mode, without gradients.
        wheels: positions in the body frame, from the pose point [m].
        ground: ground-truth features, used instead of features from cameras.
        seed: seed of the sampled controls.
        spread: spread of the model's predictions, for risks that need it.
        reverses: whether the gear can be commanded.

    Attributes:
        follower: plans and modes.
        watch: wall-clock times of the stages.
        events: changes of mode, oldest first.
        failures: reasons of failed plans.
        dropped: number of dropped messages by reason.

    Raises:
        PlanningError: the model reads features without an extractor, the GPU kernels do not support it, or the risk
            needs a spread.
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
        spread: Spread | None = None,
        reverses: bool = True,
    ) -> None:
        self._settings = settings or RuntimeSettings()
        self._dynamics = dynamics.eval().requires_grad_(False)
        if dynamics.encoder is not None and ground is None and sensors.extract is None:
            raise PlanningError("the model reads features, but has no extractor", how="give SensorSetup(…, extract=…)")
        timeouts, actuators = self._settings.timeouts, dynamics.vehicle.actuators
        self.watch, self._track = Stopwatch(), VehicleTrack(slowest=timeouts.state, actuators=actuators)
        self.follower = Follower(self._settings, self._track, CourseTracker(course))
        self._maker = PlanMaker(
            dynamics, wheels, self._settings,
            ground=ground, spread=spread, seed=seed, reverses=reverses, watch=self.watch,
        )  # fmt: skip
        encoder = None if ground is not None else encoder_on(self._settings.device, dynamics.encoder)
        self._mapper = OnlineMapper(sensors, encoder, self._track, self._settings.replay, self.watch)
        self.events, self.failures, self.dropped = self.follower.events, self._maker.failures, self._mapper.dropped
        self._intake = Intake(self._track, actuators, timeouts, self.dropped)
        self._plan_due = -np.inf
        self._predictions: deque[Prediction] = deque(maxlen=round(self._settings.remember * self._settings.plan_rate))

    @property
    def course_tracker(self) -> CourseTracker:
        """Position along the course."""
        return self.follower.tracker

    @property
    def predictions(self) -> list[Prediction]:
        """Predictions of the last plans, oldest first."""
        return list(self._predictions)

    def vehicle(self, reading: VehicleReading) -> None:
        """Add a reading of the vehicle; unusable readings are dropped and counted (`dropped`)."""
        taken = self._intake.vehicle(reading)
        if taken == "jumped":
            self._mapper.restart()
            self._maker.forget()
            self.course_tracker.lose()
        if taken != "dropped":
            self.course_tracker.move(reading.position[:2])
            self._mapper.catch_up()

    def image(self, image: Image) -> None:
        """Add an image."""
        if not self._intake.ahead(image.camera, image.time):
            self._mapper.image(image)

    def scan(self, scan: Cloud) -> None:
        """Add a scan."""
        if not self._intake.ahead(scan.lidar, scan.time):
            self._mapper.scan(scan)

    def forget_map(self) -> None:
        """Clear the map."""
        self._mapper.restart()

    @torch.no_grad()
    def step(self, now: float, applied: Applied | None = None, held: str = "") -> Controls:
        """Return the controls for the next `conventions.DT`, making a plan if one is due; call it at that interval.

        If the clock goes back, poses, map and plans are forgotten, and the vehicle may be anywhere on its course.

        Args:
            now: time [s].
            applied: see `Follower.follow`.
            held: reason to stop the vehicle whatever its inputs say, while planning continues; empty for none.
        """
        if now < self._intake.now < np.inf:
            self._restart()
            self.events.append(Event(now, "stopping", "the clock went back"))
        self._intake.now = now
        decision = self._mode(now)
        if now >= self._plan_due - 1e-6:
            self._plan_due = now + 1 / self._settings.plan_rate
            if decision.mode != "stopping" or decision.why in ("no plan", "empty map", "stuck"):
                self._plan(now, decision)
                decision = self._mode(now)
        if held and decision.mode != "stopping":
            decision = ModeDecision("stopping", held)
        return self.follower.follow(now, decision, applied)

    def _plan(self, now: float, decision: ModeDecision) -> None:
        """Plan on the current map; if that fails, the last plan remains."""
        latest = self._track.latest
        assert latest is not None
        with single_threaded_torch():
            layers, rows = self._mapper.layers(), self._track.rows(latest.time)
            planned = self._maker.plan(now, layers, self.follower, rows, latest.time, slow=decision.slow)
        if planned is not None:
            self.follower.schedule.add(planned.plan)
            self._predictions.append(planned.plan.prediction)

    def _mode(self, now: float) -> ModeDecision:
        state = replace(self._mapper.state, empty=self._maker.map_empty, stuck=self._maker.stuck)
        return self.follower.mode(now, state)

    def _restart(self) -> None:
        self._track.clear()
        self.follower.restart()
        self._mapper.restart()
        self._maker.forget()
        self._plan_due = -np.inf
