"""The hybrid model: parametric bicycle, and a recurrent network that compensates its forces (paper, eq. 5)."""

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import DT
from offpiste.dynamics.actuators import TORCH, Actuators
from offpiste.dynamics.base import Dynamics, Step, Vehicle
from offpiste.dynamics.bicycle import BicycleConstants, Constants, Force, Rates, forces, rates
from offpiste.dynamics.encoder import FeatureEncoder
from offpiste.dynamics.inputs import body_normal, drive_train, select_present
from offpiste.dynamics.lstm import Compensator
from offpiste.state import History, ModelState, Terrain


class Parametric(Dynamics):
    """Actuator lags and the bicycle, nothing learned but constants (`parametric`)."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self.vehicle = vehicle
        self.actuators = Actuators(vehicle)
        self.bicycle = BicycleConstants(vehicle)

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B 4"]) -> ModelState:
        """Only the actuators' residuals remember anything."""
        return ModelState(state, actuators, *self.actuators.start(history))

    def stepper(self) -> Step:
        """Forces, then rates, then forward Euler."""
        lags, constants = self.actuators.constants(), self.bicycle()

        def step(model_state: ModelState, control: Float[Tensor, "B 3"], terrain: Terrain) -> ModelState:
            normal = body_normal(terrain, model_state.state[:, 2])
            force = parametric_forces(
                self.vehicle, constants, model_state.state, model_state.actuators, control, normal
            )
            state = advance(self.vehicle, constants, model_state.state, model_state.actuators, control, normal, force)
            moved = self.actuators.step(
                lags, model_state.actuators, control, model_state.state[:, 3], model_state.hidden, model_state.cell
            )
            return ModelState(state, *moved)

        return step


class Hybrid(Dynamics):
    """The paper's model without (`b`) or with encoded terrain features: the network sees the physics and corrects F.

    It sees vx, vy, yaw rate, actuators and controls that the log has, the mean normal, the parametric forces and the
    codes of the four wheels; never position or yaw.

    Args:
        encoder: of the terrain features; None for `b`.
        holds: the codes of the start stay for the whole horizon (`hold`): what looking ahead is worth shows beside it.
        history: units of the networks that read the last 0.2 s.
        width: units of the layer that turns the LSTM's state and inputs into the compensation.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        encoder: FeatureEncoder | None = None,
        holds: bool = False,
        history: int = 20,
        width: int = 20,
    ) -> None:
        super().__init__()
        self.vehicle, self.encoder, self.holds = vehicle, encoder, holds
        self.codes = codes = encoder.size if encoder is not None else 0
        self.actuators = Actuators(vehicle)
        self.bicycle = BicycleConstants(vehicle)
        inputs = 3 + len(vehicle.actuators) + len(vehicle.control) + 3 + 4 + 4 * codes
        self.compensator = Compensator(inputs, 4, width=width, init_hidden=history, init_width=history)
        self.force_scale: Tensor
        # One unit of the network's output is 1 m/s^2 of the whole vehicle, or 1 rad/s^2.
        self.register_buffer("force_scale", torch.tensor([vehicle.mass / 2, vehicle.mass, vehicle.mass, 1.0]))

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B 4"]) -> ModelState:
        """The LSTM's state comes from the last 0.2 s."""
        hidden, cell = self.compensator.start(self.recorded_inputs(history))
        others = self.actuators.start(history)
        return ModelState(state, actuators, torch.cat((hidden, others[0]), -1), torch.cat((cell, others[1]), -1))

    def stepper(self) -> Step:
        """Parametric forces, their compensation, then rates and forward Euler."""
        lags, constants = self.actuators.constants(), self.bicycle()
        sizes = [self.compensator.hidden, self.actuators.hidden]

        def step(model_state: ModelState, control: Float[Tensor, "B 3"], terrain: Terrain) -> ModelState:
            hidden, hidden_lags = model_state.hidden.split(sizes, dim=-1)
            cell, cell_lags = model_state.cell.split(sizes, dim=-1)
            normal = body_normal(terrain, model_state.state[:, 2])
            force = parametric_forces(
                self.vehicle, constants, model_state.state, model_state.actuators, control, normal
            )
            seen = self._inputs(model_state.state, model_state.actuators, control, normal, force, terrain.latent)
            correction, hidden, cell = self.compensator(seen, hidden, cell)
            force = force + correction * self.force_scale
            state = advance(self.vehicle, constants, model_state.state, model_state.actuators, control, normal, force)
            actuators, hidden_lags, cell_lags = self.actuators.step(
                lags, model_state.actuators, control, model_state.state[:, 3], hidden_lags, cell_lags
            )
            return ModelState(state, actuators, torch.cat((hidden, hidden_lags), -1), torch.cat((cell, cell_lags), -1))

        return step

    def recorded_inputs(self, history: History) -> Float[Tensor, "B H I"]:
        """What the network would have seen at recorded rows."""
        normal = body_normal(history.terrain, history.state[..., 2])
        force = parametric_forces(
            self.vehicle, self.bicycle(), history.state, history.actuators, history.control, normal
        )
        return self._inputs(history.state, history.actuators, history.control, normal, force, history.terrain.latent)

    def _inputs(
        self,
        state: Float[Tensor, "*B 6"],
        actuators: Float[Tensor, "*B 4"],
        control: Float[Tensor, "*B 3"],
        normal: Float[Tensor, "*B 3"],
        force: Float[Tensor, "*B 4"],
        latent: Float[Tensor, "*B 4 E"],
    ) -> Float[Tensor, "*B I"]:
        present = select_present(self.vehicle, actuators, control)
        columns = [state[..., 3:], present, normal, force]
        return torch.cat(columns + ([latent.flatten(-2)] if self.codes else []), dim=-1)


def parametric_forces(
    vehicle: Vehicle,
    constants: Constants,
    state: Float[Tensor, "*B 6"],
    actuators: Float[Tensor, "*B 4"],
    control: Float[Tensor, "*B 3"],
    normal: Float[Tensor, "*B 3"],
) -> Float[Tensor, "*B 4"]:
    """The force vector F (eq. 1) on batches."""
    train = drive_train(vehicle, state, actuators, control)
    _, _, _, vx, vy, yaw_rate = state.unbind(-1)
    force = forces(
        vx, vy, yaw_rate, train.brake, train.steer, train.engine, train.throttle, normal[..., 2], constants, TORCH
    )
    return torch.stack(force, dim=-1)


def advance(
    vehicle: Vehicle,
    constants: Constants,
    state: Float[Tensor, "B 6"],
    actuators: Float[Tensor, "B 4"],
    control: Float[Tensor, "B 3"],
    normal: Float[Tensor, "B 3"],
    force: Float[Tensor, "B 4"],
) -> Float[Tensor, "B 6"]:
    """The state one step later: h(F, x) (eq. 4) and forward Euler."""
    steer = drive_train(vehicle, state, actuators, control).steer
    _, _, yaw, vx, vy, yaw_rate = state.unbind(-1)
    change: Rates = rates(
        yaw, vx, vy, yaw_rate, steer, normal[..., 0], normal[..., 1], Force(*force.unbind(-1)), constants, TORCH
    )
    return state + DT * torch.stack(change, dim=-1)
