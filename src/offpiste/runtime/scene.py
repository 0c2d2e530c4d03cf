"""One plan on a recorded scene: the map and the vehicle's past as they were known at a moment of a log."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import HISTORY_STEPS
from offpiste.core.errors import LogError, PlanningError
from offpiste.dataset.resample import extract_rows
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.replay import MapperSettings, pinhole_cameras, replay
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning import mppi
from offpiste.planning.controls import PEDAL_AND_WHEEL, controls_of, pedals_of, with_pedal
from offpiste.planning.cost_map import cost_map
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.course import Course, Goal
from offpiste.planning.driving_cost import Situation
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import TrackRows
from offpiste.runtime.perception import codes_of
from offpiste.runtime.planner import Planner
from offpiste.runtime.prediction import coded_area, costs_from, model_state_of, predicted


@dataclass(frozen=True)
class Scene:
    """The map and the vehicle's last rows at a moment.

    Attributes:
        time: of the last row [s].
        layers: of the map, with the planner's codes of the ground as features.
        rows: of the vehicle until `time`.
        wheels: positions in the body frame, from the pose point [m].
    """

    time: float
    layers: TerrainLayers
    rows: TrackRows
    wheels: Float[np.ndarray, "4 2"]

    @property
    def state(self) -> Float[np.ndarray, " 6"]:
        """State at `time` in the world frame (`conventions.STATE`)."""
        return np.asarray(self.rows.state[-1])

    def ahead(self, forward: float, left: float = 0.0) -> Float[np.ndarray, " 2"]:
        """Place in the world frame from distances in the vehicle's frame [m]."""
        x, y, yaw = self.state[:3]
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.array((x + cos * forward - sin * left, y + sin * forward + cos * left))


@dataclass(frozen=True)
class DrivingPlan:
    """A plan and where the model predicts that it leads.

    Attributes:
        controls: throttle, brake and steer of each step of `conventions.DT`.
        states: predicted state after each step, in the world frame.
        cost: predicted cost of the plan.
        cost_before: of the controls that were improved.
    """

    controls: Float[Tensor, "T 3"]
    states: Float[np.ndarray, "T 6"]
    cost: float
    cost_before: float


def read_scene(log: Log, rig: Rig, planner: Planner, seconds: float, settings: MapperSettings | None = None) -> Scene:
    """Replay the start of a log, as on the vehicle, and return the scene that a planner has then.

    Args:
        seconds: since the first pose.

    Raises:
        LogError: the log has no scan or no complete history by then.
        PlanningError: the planner reads features that no camera gives.
    """
    model, extractor = planner.dynamics.requires_grad_(False), planner.extractor
    if planner.knows_ground:
        raise PlanningError(
            f"'{planner.name}' reads the ground's true properties", how="give a planner of visual features"
        )
    sensors = open_sensors(log, rig)
    now = sensors.poses.span[0] + seconds
    cameras = {} if extractor is None else pinhole_cameras(sensors, extractor.patch)

    def codes(pixels: np.ndarray) -> np.ndarray:
        assert extractor is not None
        assert model.encoder is not None
        return codes_of(pixels, extractor.extract, model.encoder)

    size = 0 if model.encoder is None else model.encoder.size
    moment = None
    for moment in replay(sensors, cameras, codes, size, settings, end=now):  # noqa: B007
        pass
    if moment is None:
        raise LogError(f"no scan in the first {seconds:g} s", where=log.path, how="choose a later moment")
    rows = extract_rows(drive_from_log(log, rig))
    t = int(np.searchsorted(rows.time, now, side="right")) - 1
    last = slice(t - HISTORY_STEPS, t + 1)
    if last.start < 0 or not rows.valid[last].all():
        raise LogError(
            f"no complete history at {seconds:g} s", where=log.path, how="choose a moment where all channels are there"
        )
    state = rows.state_causal[last].astype(float)
    state[:, :2] += rows.origin
    track = TrackRows(state, rows.actuators_causal[last], rows.control_causal[last], np.ones(HISTORY_STEPS + 1))
    return Scene(float(rows.time[t]), moment.layers, track, np.asarray(rig.wheel_positions()))


@torch.no_grad()
def plan(
    planner: Planner,
    scene: Scene,
    course: Course | Goal,
    *,
    weights: CostWeights | None = None,
    hazards: Hazards | None = None,
    sampling: mppi.Settings | None = None,
    before: Float[Tensor, "T 3"] | int = 150,
    seed: int = 0,
) -> DrivingPlan:
    """Plan controls along a course or to a goal by MPPI, from a scene.

    Args:
        sampling: of pedal and steering; by default five rounds of 512 samples.
        before: controls to improve; a number of steps begins with doing nothing.
        seed: of the sampled controls.

    Raises:
        NoPlan: no sample has a finite cost.
    """
    model, weights = planner.dynamics.eval().requires_grad_(False), weights or CostWeights()
    sampling = sampling or mppi.Settings(PEDAL_AND_WHEEL, (0.3, 0.3), samples=512, temperature=3.0, iterations=5)
    area = coded_area(scene.layers, model.encoder)
    wheels = torch.as_tensor(scene.wheels, dtype=torch.float32)
    offset = torch.tensor(scene.state[:2])
    start = model_state_of(model, scene.rows, area, wheels, offset)
    costs = cost_map(area.layers, course, hazards or Hazards())
    last = torch.as_tensor(scene.rows.control[-2], dtype=torch.float32)
    at = Situation(area.stack, costs, wheels, offset, start.state[0], last)
    cost_of = costs_from(model, start, area, at, weights)
    controls = torch.zeros(before, 3) if isinstance(before, int) else before
    generator = torch.Generator().manual_seed(seed)
    improved = controls_of(mppi.improve(pedals_of(controls), with_pedal(cost_of), sampling, generator).controls)
    cost_before, cost = cost_of(torch.stack((controls, improved))).tolist()
    return DrivingPlan(improved, predicted(model, start, improved, area, at, weights), cost, cost_before)
