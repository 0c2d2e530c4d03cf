"""Baselines: constant motion, a kinematic bicycle, and a recurrent network without physics."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT
from offpiste.core.state import History, ModelState, Terrain
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.base import Dynamics, Step
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.models import register_model
from offpiste.dynamics.torch_physics import UNKNOWN, drive_train, mean_normal, select_present, unknown_normals
from offpiste.dynamics.vehicle import Vehicle


@register_model("ctrv", baseline=True, colour="#8c8c8c", what="constant turn rate and velocity")
class ConstantMotion(Dynamics):
    """Constant turn rate and velocity (`ctrv`)."""

    reads_terrain = False

    def stepper(self) -> Step:
        """Return a step function that integrates the pose at constant velocity and turn rate."""

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            return replace(model_state, state=_integrated(model_state.state, model_state.state[:, 3:]))

        return step


@register_model(
    "kinematic",
    baseline=True,
    colour="#cc79a7",
    what="a bicycle at constant speed",
    fits=lambda vehicle: vehicle.steers,
)
class Kinematic(Dynamics):
    """Kinematic bicycle at constant speed (`kinematic`): yaw rate = v tan(delta) / wheelbase, no slip of the rear axle.

    A recorded steering angle follows its command through the fitted delay model, as in every other model.
    """

    reads_terrain = False
    actuators: Actuators

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self.actuators = Actuators(vehicle)

    def stepper(self) -> Step:
        """Return a step function that integrates the pose along the steering arc."""
        lags = self.actuators.constants()

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            steer = drive_train(self.vehicle, model_state.state, model_state.actuators, control).steer
            vx = model_state.state[:, 3]
            yaw_rate = vx * torch.tan(steer) / self.vehicle.wheelbase
            # The rear axle does not slip; keeping the initial lateral velocity for 5 s would be an unfair baseline.
            velocity = torch.stack((vx, self.vehicle.rear_axle * yaw_rate, yaw_rate), dim=-1)
            state = _integrated(torch.cat((model_state.state[:, :3], velocity), dim=-1), velocity)
            moved = self.actuators.step(lags, model_state.actuators, control, vx, model_state.recurrent)
            return ModelState(state, *moved)

        return step


@register_model("lstm", colour="#b8a400", what="a network without physics")
class Recurrent(Dynamics):
    """Network of the hybrid model that predicts accelerations without physics (`lstm`)."""

    actuators: Actuators

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self.actuators = Actuators(vehicle)
        before = 3 + len(vehicle.actuators) + len(vehicle.control) + 3
        self.unknown = slice(before, before + UNKNOWN)
        self.network = Compensator(before + UNKNOWN, 3)

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """Initialise the networks from the last 0.2 s."""
        own, begun = self.network.start(self.recorded_inputs(history)), super().start(history, state, actuators)
        return replace(begun, recurrent=torch.cat((own, begun.recurrent), dim=-1))

    def stepper(self) -> Step:
        """Return a step function that integrates the predicted accelerations and the pose."""
        lags = self.actuators.constants()
        sizes = self.network.state_size, self.actuators.recurrent_size

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            state, actuators = model_state.state, model_state.actuators
            own, of_lags = model_state.recurrent.split(sizes, dim=-1)
            acceleration, own = self.network(self._inputs(state, actuators, control, terrain), own)
            after = _integrated(state, state[:, 3:] + DT * acceleration)
            actuators, of_lags = self.actuators.step(lags, actuators, control, state[:, 3], of_lags)
            return ModelState(after, actuators, torch.cat((own, of_lags), dim=-1))

        return step

    def standardise_on(self, history: History) -> None:
        """Set mean and scale of the network's inputs."""
        self.network.standardise_on(self.recorded_inputs(history).flatten(0, 1), self.unknown)

    def recorded_inputs(self, history: History) -> Float[Tensor, "B H I"]:
        """Return the network's inputs at recorded rows."""
        return self._inputs(history.state, history.actuators, history.control, history.terrain)

    def _inputs(
        self,
        state: Float[Tensor, "*B 6"],
        actuators: Float[Tensor, "*B A"],
        control: Float[Tensor, "*B U"],
        terrain: Terrain,
    ) -> Float[Tensor, "*B I"]:
        present = select_present(self.vehicle, actuators, control)
        columns = state[..., 3:], present, mean_normal(terrain, state[..., 2]), unknown_normals(terrain)
        return torch.cat(columns, dim=-1)


def _integrated(state: Float[Tensor, "B 6"], velocity: Float[Tensor, "B 3"]) -> Float[Tensor, "B 6"]:
    """Return the pose after one step at the present velocity, and the next velocity."""
    px, py, yaw, vx, vy, _ = state.unbind(-1)
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    pose = torch.stack(
        (px + DT * (cos * vx - sin * vy), py + DT * (sin * vx + cos * vy), yaw + DT * velocity[:, 2]), dim=-1
    )
    return torch.cat((pose, velocity), dim=-1)
