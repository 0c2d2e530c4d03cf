"""Models to be better than: constant motion, a kinematic bicycle, and a recurrent network without physics."""

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT
from offpiste.core.state import History, ModelState, Terrain
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.base import Dynamics, Step
from offpiste.dynamics.inputs import UNKNOWN, body_normal, drive_train, select_present, unknown_normals
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.models import register_model
from offpiste.dynamics.vehicle import Vehicle


@register_model("ctrv", baseline=True, colour="#8c8c8c", what="constant turn rate and velocity")
class ConstantMotion(Dynamics):
    """Constant turn rate and velocity (`ctrv`): vx, vy and yaw rate stay as they are."""

    reads_terrain = False

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """Nothing but the state."""
        nothing = state.new_zeros(len(state), 0)
        return ModelState(state, actuators, nothing, nothing)

    def stepper(self) -> Step:
        """Integrate the pose."""

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            return ModelState(
                _moved(model_state.state, model_state.state[:, 3:]),
                model_state.actuators,
                model_state.hidden,
                model_state.cell,
            )

        return step


@register_model(
    "kinematic",
    baseline=True,
    colour="#cc79a7",
    what="a bicycle at constant speed",
    fits=lambda vehicle: vehicle.steers,
)
class Kinematic(Dynamics):
    """Bicycle at constant speed that turns by its geometry (`kinematic`): yaw rate = v tan(delta) / wheelbase,
    and the rear axle moves where it points.

    A steering angle that the log records follows its command through the fitted delay model, as in every other model.
    """

    reads_terrain = False
    actuators: Actuators

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self.actuators = Actuators(vehicle)

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """Only the actuators' residuals remember anything."""
        return ModelState(state, actuators, *self.actuators.start(history))

    def stepper(self) -> Step:
        """Integrate the pose along the steered arc."""
        lags = self.actuators.constants()

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            steer = drive_train(self.vehicle, model_state.state, model_state.actuators, control).steer
            vx = model_state.state[:, 3]
            yaw_rate = vx * torch.tan(steer) / self.vehicle.wheelbase
            # The rear axle does not slip; the start's lateral velocity, held for 5 s, would be a straw man.
            velocity = torch.stack((vx, self.vehicle.rear_axle * yaw_rate, yaw_rate), dim=-1)
            state = _moved(torch.cat((model_state.state[:, :3], velocity), dim=-1), velocity)
            return ModelState(
                state,
                *self.actuators.step(lags, model_state.actuators, control, vx, model_state.hidden, model_state.cell),
            )

        return step


@register_model("lstm", colour="#b8a400", what="a network without physics")
class Recurrent(Dynamics):
    """An LSTM without physics (`lstm`): the same network as the hybrid's, but it predicts accelerations by itself."""

    actuators: Actuators

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self.actuators = Actuators(vehicle)
        before = 3 + len(vehicle.actuators) + len(vehicle.control) + 3
        self.unknown = slice(before, before + UNKNOWN)
        self.network = Compensator(before + UNKNOWN, 3)

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """The LSTM's state comes from the last 0.2 s."""
        hidden, cell = self.network.start(self.recorded_inputs(history))
        others = self.actuators.start(history)
        return ModelState(state, actuators, torch.cat((hidden, others[0]), -1), torch.cat((cell, others[1]), -1))

    def stepper(self) -> Step:
        """Accelerations from the network, pose by integration."""
        lags = self.actuators.constants()
        own = self.network.hidden

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            hidden, cell = model_state.hidden[:, :own], model_state.cell[:, :own]
            seen = self._inputs(model_state.state, model_state.actuators, control, terrain)
            acceleration, hidden, cell = self.network(seen, hidden, cell)
            state = _moved(model_state.state, model_state.state[:, 3:] + DT * acceleration)
            return self.actuators.advance(lags, model_state, control, state, hidden, cell)

        return step

    @property
    def recurrent_size(self) -> int:
        """Units of the network and of the actuators' residuals."""
        return self.network.hidden + self.actuators.hidden

    def standardise_on(self, history: History) -> None:
        """Set mean and scale of the network's inputs."""
        self.network.standardise_on(self.recorded_inputs(history).flatten(0, 1), self.unknown)

    def recorded_inputs(self, history: History) -> Float[Tensor, "B H I"]:
        """What the network would have seen at recorded rows."""
        return self._inputs(history.state, history.actuators, history.control, history.terrain)

    def _inputs(
        self,
        state: Float[Tensor, "*B 6"],
        actuators: Float[Tensor, "*B A"],
        control: Float[Tensor, "*B U"],
        terrain: Terrain,
    ) -> Float[Tensor, "*B I"]:
        present = select_present(self.vehicle, actuators, control)
        columns = state[..., 3:], present, body_normal(terrain, state[..., 2]), unknown_normals(terrain)
        return torch.cat(columns, dim=-1)


def _moved(state: Float[Tensor, "B 6"], velocity: Float[Tensor, "B 3"]) -> Float[Tensor, "B 6"]:
    """The pose after one step at the present velocities, and the next velocities."""
    px, py, yaw, vx, vy, _ = state.unbind(-1)
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    pose = torch.stack(
        (px + DT * (cos * vx - sin * vy), py + DT * (sin * vx + cos * vy), yaw + DT * velocity[:, 2]), dim=-1
    )
    return torch.cat((pose, velocity), dim=-1)
