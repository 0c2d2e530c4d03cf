"""Planning on a recorded scene: the map and the vehicle's past at a time of a log."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import CONTROL, HISTORY_STEPS
from offpiste.core.errors import LogError, PlanningError
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log
from offpiste.logs.sensor_log import open_sensors
from offpiste.mapping.replay import MapperSettings, pinhole_cameras, replay
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.planning import mppi
from offpiste.planning.controls import PEDAL_LIMITS, controls_of, pedals_of, with_pedal
from offpiste.planning.costs.layers import Hazards, cost_map
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
    """The map and the vehicle's last rows at one time.

    Attributes:
        time: stamp of the last row [s].
        layers: map layers, with the codes of the planner as features.
        rows: states, actuators and controls of the vehicle up to `time`.
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
        """Convert a point in the body frame to x, y in the world frame [m]."""
        x, y, yaw = self.state[:3]
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.array((x + cos * forward - sin * left, y + sin * forward + cos * left))


@dataclass(frozen=True)
class DrivingPlan:
    """A plan and its predicted trajectory.

    Attributes:
        controls: throttle, brake and steer at steps of `conventions.DT`.
        states: predicted state after each step (`conventions.STATE`), in the world frame.
        cost: predicted cost of the plan.
        cost_before: predicted cost of the initial controls.
    """

    controls: Float[Tensor, "T 3"]
    states: Float[np.ndarray, "T 6"]
    cost: float
    cost_before: float


def read_scene(log: Log, rig: Rig, planner: Planner, seconds: float, settings: MapperSettings | None = None) -> Scene:
    """Replay a log up to a time, as on the vehicle, and return the scene known then.

    The rows end with the first one after the last measurement in the map, so that the map contains nothing later.
    Delays and clock alignments of the rig are known from the whole log.

    Args:
        seconds: time since the first pose.

    Raises:
        LogError: there is no scan, or no complete history of the vehicle, at that time.
        PlanningError: the planner reads the simulator's ground properties.
    """
    model, extractor = planner.dynamics.requires_grad_(False), planner.extractor
    if planner.knows_ground:
        what = f"'{planner.name}' reads the ground's true properties"
        raise PlanningError(what, how="give a planner of visual features")
    sensors = open_sensors(log, rig)
    first, last = sensors.poses.span
    now = first + seconds
    if now > last:
        how = f"choose a time up to {last - first:.1f} s"
        raise LogError(f"the poses end before {seconds:g} s", where=log.path, how=how)
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
        raise LogError(f"no scan in the first {seconds:g} s", where=log.path, how="choose a later time")
    rows = extract_rows(drive_from_log(log, rig))
    t = int(np.searchsorted(rows.time, max(now, moment.placed)))
    if not HISTORY_STEPS <= t < len(rows.time) or not rows.valid[t - HISTORY_STEPS : t + 1].all():
        how = "choose a time at which all channels have data"
        raise LogError(f"no complete history of the vehicle at {seconds:g} s", where=log.path, how=how)
    track = track_of(rows, [control.name for control in rig.controls], t)
    return Scene(float(rows.time[t]), moment.layers, track, np.asarray(rig.wheel_positions()))


def track_of(rows: Rows, controls: Sequence[str], t: int) -> TrackRows:
    """Return rows t-10 ... t as causal estimates in the world frame; without a control "gear", driven forward."""
    last = slice(t - HISTORY_STEPS, t + 1)
    state, control = rows.state_causal[last].astype(float), rows.control_causal[last]
    state[:, :2] += rows.origin
    gear = control[:, list(controls).index("gear")] if "gear" in controls else np.ones(len(control))
    return TrackRows(state, rows.actuators_causal[last], control[:, : len(CONTROL)], gear.astype(float))


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
    """Plan controls along a course or to a goal by MPPI; the vehicle drives forward.

    Args:
        course: in the world frame.
        sampling: settings of MPPI for pedal and steer; by default five iterations of 512 samples.
        before: initial controls, or the number of steps, initialised with zeros.
        seed: seed of the sampled controls.

    Raises:
        NoPlan: no sample has a finite cost.
    """
    model, weights = planner.dynamics.eval().requires_grad_(False), weights or CostWeights()
    sampling = sampling or mppi.Settings(PEDAL_LIMITS, (0.3, 0.3), samples=512, temperature=3.0, iterations=5)
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
