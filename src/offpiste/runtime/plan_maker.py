"""Plans on the current map, from the vehicle's last rows and the committed controls."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Float

from offpiste.core.conventions import HORIZON_STEPS
from offpiste.core.errors import NoPlan
from offpiste.core.state import ModelState
from offpiste.dynamics.base import Dynamics
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning import mppi
from offpiste.planning.caution import caution_of
from offpiste.planning.controls import controls_of, pedals_of, with_pedal
from offpiste.planning.costs.layers import CostMap, cost_map
from offpiste.planning.course import Course, Way, ways_from
from offpiste.planning.device_planner import DevicePlanner
from offpiste.planning.driving_cost import Situation
from offpiste.planning.gpu import check_planner, gpu_planner, require_device
from offpiste.runtime.backing_out import BackingOut
from offpiste.runtime.estimator import TrackRows
from offpiste.runtime.follower import Follower, TimedPlan
from offpiste.runtime.perception import Stopwatch
from offpiste.runtime.prediction import (
    Area,
    KnownGround,
    Prediction,
    coded_area,
    costs_from,
    model_state_after,
    model_state_of,
    predicted,
    reachable,
)
from offpiste.runtime.settings import RuntimeSettings
from offpiste.uncertainty.spread import Spread

FRESH: Final = 0.5
"""Maximum age of a plan along a way that is still continued [s]."""


class Planned(NamedTuple):
    """A plan and its cost."""

    plan: TimedPlan
    cost: float


class PlanImprover:
    """MPPI on the CPU or on a GPU; raises `PlanningError` if there is no such GPU, or no GPU kernel for the model."""

    def __init__(self, dynamics: Dynamics, settings: RuntimeSettings, seed: int) -> None:
        self._dynamics, self._settings, self._seed = dynamics, settings, seed
        self._generator = torch.Generator().manual_seed(seed)
        self._on_gpu: DevicePlanner | None = None
        require_device(settings.device, dynamics)

    def improve(
        self, controls: Float[torch.Tensor, "T 3"], model_state: ModelState, area: Area, at: Situation
    ) -> mppi.Plan:
        """Return a plan of pedal and steer, given an initial plan of throttle, brake and steer.

        Raises:
            NoPlan: no sample has a finite cost.
            PlanningError: results on the GPU differ from those on the CPU.
        """
        settings, before, previous = self._settings, pedals_of(controls), pedals_of(at.control)
        if settings.device == "cpu":
            cost_of = with_pedal(costs_from(self._dynamics, model_state, area, at, settings.weights))
            return mppi.improve(before, cost_of, settings.sampling, self._generator, previous=previous)
        if self._on_gpu is None:
            planner = gpu_planner(self._dynamics, settings.sampling, at, settings.device, self._seed)
            check_planner(planner, before, model_state, at, settings.weights, area.codes)
            self._on_gpu = planner
        return self._on_gpu.improve(before, model_state, at, settings.weights, area.codes, previous=previous)


class PlanMaker:
    """Makes plans with a model in evaluation mode, without gradients; other arguments as of `Runtime`.

    Attributes:
        map_empty: whether the map had no ground within reach of the last plan.
        failures: reasons of failed plans.

    Raises:
        PlanningError: the GPU kernels do not support the model, or the risk needs a spread.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        wheels: Float[np.ndarray, "4 2"],
        settings: RuntimeSettings,
        *,
        ground: KnownGround | None = None,
        spread: Spread | None = None,
        seed: int = 0,
        reverses: bool = True,
        watch: Stopwatch | None = None,
    ) -> None:
        self._dynamics, self._settings, self._ground = dynamics, settings, ground
        self._wheels = torch.as_tensor(wheels, dtype=torch.float32)
        self._caution = caution_of(settings.risk, spread)
        self._improver = PlanImprover(dynamics, settings, seed)
        self._watch = watch or Stopwatch()
        backs_out = reverses and "gear" in dynamics.vehicle.control_columns
        chosen = settings.backing_out
        self._backing_out = BackingOut(chosen if backs_out else replace(chosen, attempts=0))
        self._way = 0  # number of the chosen way
        self.map_empty = False
        self.failures: list[str] = []
        self.forget()

    def forget(self) -> None:
        """Forget stuck places and plans along ways, as poses to come are in another frame."""
        self._backing_out.forget()
        self._along_ways: dict[int, Planned] = {}  # last plans by the numbers of their ways
        self._stuck_at = -np.inf  # last position along the course where the vehicle was stuck
        self._found_stuck: tuple[np.ndarray, Course] | None = None  # place and course, until a map is available

    def plan(
        self, now: float, layers: TerrainLayers, follower: Follower, rows: TrackRows, read: float, *, slow: bool
    ) -> Planned | None:
        """Make a plan that acts after the latency; None if stuck, on an empty map, or without finite costs.

        Args:
            follower: source of the position on the course and of the committed controls; the plan is not added to it.
            rows: rows up to the last reading of the vehicle, at the time `read` [s].
            slow: whether the speed is limited.
        """
        settings, state = self._settings, rows.state[-1]
        section = self._section(now, state, follower, slow=slow)
        if self.stuck:
            return None
        near = reachable(layers, state, float(section.speed.max()), self._backing_out.gear, settings.margin)
        self.map_empty = not near.known.any()
        if self.map_empty:
            return None
        with self._watch.of("encode map"):
            area = coded_area(near, self._dynamics.encoder, self._ground)
        with self._watch.of("cost map"):
            ways = ways_from(self._backing_out.course(section), state[:2])
            hazards = self._backing_out.hazards(settings.hazards)
            costs = [cost_map(near, way.course, hazards) for way in ways]
            self._choose_side(near)
        with self._watch.of("start"):
            model_state, at = self._start(now, follower, rows, read, area, costs[0])
        with self._watch.of("plan"):
            starts = self._continued(now, follower, ways, at.gear)
            situations = [replace(at, costs=each) for each in costs]
            plans = [self._improved(now, *each, area, model_state) for each in zip(starts, situations, strict=True)]
            return self._cheapest(ways, plans)

    def _section(self, now: float, state: Float[np.ndarray, " 6"], follower: Follower, *, slow: bool) -> Course:
        """Return the section of the course around the vehicle, and detect whether the vehicle is stuck."""
        settings, tracker = self._settings, follower.tracker
        behind = self._backing_out.away or tracker.progress <= self._stuck_at
        section = tracker.stretch(at_most=settings.highest_speed(slow=slow), backed_out=behind)
        driven = not follower.stopping and tracker.target > settings.standstill
        if self._backing_out.update(now, state[:3], section, driven=driven):
            self._stuck_at, self._found_stuck = tracker.progress, (state[:2].copy(), section)
        return section

    def _choose_side(self, near: TerrainLayers) -> None:
        """Choose the side of a newly found stuck place, on the map with full hazards."""
        if self._found_stuck is None:
            return
        place, followed = self._found_stuck
        costs = cost_map(near, followed, self._settings.hazards)

        def hazard(places: np.ndarray) -> np.ndarray:
            values = costs.at(torch.from_numpy(places), torch.zeros(2, dtype=torch.float64))
            return np.asarray(values[:, costs.names.index("hazard")])

        self._backing_out.choose_side(place, followed, hazard)
        self._found_stuck = None

    def _start(
        self, now: float, follower: Follower, rows: TrackRows, read: float, area: Area, costs: CostMap
    ) -> tuple[ModelState, Situation]:
        """Predict through the committed controls to the start of the new plan."""
        offset = torch.from_numpy(rows.state[-1, :2].copy())
        given = follower.committed(read, now + self._settings.latency, rows)
        committed = torch.as_tensor(given, dtype=torch.float32)
        last = committed[-1] if len(committed) else torch.as_tensor(rows.control[-2], dtype=torch.float32)
        engaged = follower.engaged  # until the plan acts
        model_state = model_state_of(self._dynamics, rows, area, self._wheels, offset, engaged)
        begin = model_state.state[0]
        at = Situation(area.stack, costs, self._wheels, offset, begin, last, engaged, self._caution)
        model_state = model_state_after(self._dynamics, model_state, committed, area, at)
        return model_state, replace(at, state=model_state.state[0], gear=self._backing_out.gear)

    def _continued(
        self, now: float, follower: Follower, ways: Sequence[Way], gear: float
    ) -> list[Float[torch.Tensor, "T 3"]]:
        """Return the initial plan for each way: the last one along it, or else the last one; rest in another gear."""
        rest = controls_of(torch.tensor(self._settings.sampling.rest or (0.0, 0.0)))
        starts = []
        for way in ways:
            own, plan = self._along_ways.get(way.number), follower.schedule.latest
            if len(ways) > 1 and own is not None and own.plan.gear == gear and 0 <= now - own.plan.made < FRESH:
                plan = own.plan
            if plan is None or plan.gear != gear:
                starts.append(rest.repeat(HORIZON_STEPS, 1))
            else:
                starts.append(plan.continued(now + self._settings.latency))
        return starts

    def _improved(
        self, now: float, before: Float[torch.Tensor, "T 3"], at: Situation, area: Area, model_state: ModelState
    ) -> Planned | None:
        """Return a new plan and its prediction; None if it is not finite."""
        settings, model = self._settings, self._dynamics
        start = now + settings.latency
        try:
            plan = self._improver.improve(before, model_state, area, at)
        except NoPlan as error:
            self.failures.append(str(error))
            return None
        if not plan.controls.isfinite().all():
            self.failures.append("the plan is not finite")
            return None
        controls = controls_of(plan.controls)
        states = predicted(model, model_state, controls, area, at, settings.weights)
        return Planned(TimedPlan(start, now, controls, Prediction(start, states), at.gear), plan.cost)

    def _cheapest(self, ways: Sequence[Way], plans: Sequence[Planned | None]) -> Planned | None:
        """Return the cheapest plan; the last way is kept unless another is cheaper by more than the temperature."""
        self._along_ways = {way.number: plan for way, plan in zip(ways, plans, strict=True) if plan is not None}
        if not self._along_ways:
            return None
        margin = {self._way: self._settings.sampling.temperature}
        self._way = min(self._along_ways, key=lambda number: self._along_ways[number].cost - margin.get(number, 0.0))
        return self._along_ways[self._way]

    @property
    def stuck(self) -> bool:
        """True if backing out was given up, so that no plan is made."""
        return self._backing_out.gave_up
