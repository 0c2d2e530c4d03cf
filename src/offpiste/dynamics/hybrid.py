"""The hybrid model: parametric bicycle, and a recurrent network that compensates its forces (paper, eq. 5)."""

from copy import deepcopy

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT
from offpiste.core.state import History, ModelState, Terrain
from offpiste.dataset.feature_sets import hindsight_throughout, per_trajectory
from offpiste.dynamics.actuators import TORCH, Actuators
from offpiste.dynamics.base import Dynamics, KernelParts, Step
from offpiste.dynamics.bicycle import BicycleConstants, Constants, Force, Rates, forces, rates
from offpiste.dynamics.feature_encoder import Compressor, FeatureEncoder, Identity
from offpiste.dynamics.inputs import UNKNOWN, body_normal, drive_train, select_present, unknown_normals
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.models import register_model
from offpiste.dynamics.vehicle import Vehicle


@register_model("parametric", colour="#56b4e9", what="actuator lags and a bicycle with fitted constants")
class Parametric(Dynamics):
    """Actuator lags and the bicycle, nothing learned but constants (`parametric`).

    Args:
        actuators: delay models to use; new ones where none are given.
    """

    actuators: Actuators

    def __init__(self, vehicle: Vehicle, actuators: Actuators | None = None) -> None:
        super().__init__(vehicle)
        self.actuators = actuators or Actuators(vehicle)
        self.bicycle = BicycleConstants(vehicle)

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """Only the actuators' residuals remember anything."""
        return ModelState(state, actuators, *self.actuators.start(history))

    def stepper(self) -> Step:
        """Forces, then rates, then forward Euler."""
        lags, constants = self.actuators.constants(), self.bicycle()

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
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

    def kernel_parts(self) -> KernelParts:
        """The bicycle."""
        return KernelParts(self.bicycle)


@register_model(
    "b", colour="#0072b2", display_name="blind", what="parametric, corrected by a network that does not see the ground"
)
class Hybrid(Dynamics):
    """The paper's model without (`b`) or with encoded terrain features: the network sees the physics and corrects F.

    It sees vx, vy, yaw rate, actuators and controls that the log has, the mean normal, the share of the wheels whose
    normal is unknown, the parametric forces and the codes of the four wheels; never position or yaw.

    Args:
        encoder: of the terrain features; None for `b`.
    """

    actuators: Actuators

    def __init__(self, vehicle: Vehicle, *, encoder: FeatureEncoder | None = None) -> None:
        super().__init__(vehicle)
        self.encoder = encoder
        self.actuators = Actuators(vehicle)
        self.bicycle = BicycleConstants(vehicle)
        before = 3 + len(vehicle.actuators) + len(vehicle.control) + 3
        self.unknown = slice(before, before + UNKNOWN)
        inputs = before + UNKNOWN + 4 + 4 * self.codes
        self.compensator = Compensator(inputs, 4)
        self.force_scale: Tensor
        # One unit of the network's output is 1 m/s^2 of the whole vehicle, or 1 rad/s^2.
        self.register_buffer("force_scale", torch.tensor([vehicle.mass / 2, vehicle.mass, vehicle.mass, 1.0]))

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """The LSTM's state comes from the last 0.2 s."""
        hidden, cell = self.compensator.start(self.recorded_inputs(history))
        others = self.actuators.start(history)
        return ModelState(state, actuators, torch.cat((hidden, others[0]), -1), torch.cat((cell, others[1]), -1))

    def stepper(self) -> Step:
        """Parametric forces, their compensation, then rates and forward Euler."""
        lags, constants = self.actuators.constants(), self.bicycle()
        own = self.compensator.hidden

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            hidden, cell = model_state.hidden[:, :own], model_state.cell[:, :own]
            normal = body_normal(terrain, model_state.state[:, 2])
            force = parametric_forces(
                self.vehicle, constants, model_state.state, model_state.actuators, control, normal
            )
            seen = self._inputs(model_state.state, model_state.actuators, control, normal, force, terrain)
            correction, hidden, cell = self.compensator(seen, hidden, cell)
            force = force + correction * self.force_scale
            state = advance(self.vehicle, constants, model_state.state, model_state.actuators, control, normal, force)
            return self.actuators.advance(lags, model_state, control, state, hidden, cell)

        return step

    @property
    def recurrent_size(self) -> int:
        """Units of the network and of the actuators' residuals."""
        return self.compensator.hidden + self.actuators.hidden

    def standardise_on(self, history: History) -> None:
        """Set mean and scale of the network's inputs, and the range of those that are no codes.

        Codes change while their encoder learns.
        """
        inputs = self.recorded_inputs(history).flatten(0, 1)
        self.compensator.standardise_on(inputs, self.unknown, ranged=inputs.shape[-1] - 4 * self.codes)

    def kernel_parts(self) -> KernelParts:
        """The bicycle, and what corrects its forces."""
        return KernelParts(self.bicycle, self.compensator, self.force_scale)

    def physics(self) -> Parametric:
        """A bicycle alone, not yet fitted, with a copy of the actuators, where they lie."""
        return Parametric(self.vehicle, deepcopy(self.actuators)).to(self.bicycle.raw.device)

    def adopt_physics(self, fitted: Dynamics, *, learns: bool = False) -> None:
        """Take over the bicycle's constants, and keep them unless the bicycle `learns` further."""
        parts = fitted.kernel_parts()
        assert parts is not None
        self.bicycle.load_state_dict(parts.bicycle.state_dict())
        self.bicycle.requires_grad_(learns)

    def recorded_inputs(self, history: History) -> Float[Tensor, "B H I"]:
        """What the network would have seen at recorded rows."""
        normal = body_normal(history.terrain, history.state[..., 2])
        force = parametric_forces(
            self.vehicle, self.bicycle(), history.state, history.actuators, history.control, normal
        )
        return self._inputs(history.state, history.actuators, history.control, normal, force, history.terrain)

    def _inputs(
        self,
        state: Float[Tensor, "*B 6"],
        actuators: Float[Tensor, "*B A"],
        control: Float[Tensor, "*B U"],
        normal: Float[Tensor, "*B 3"],
        force: Float[Tensor, "*B 4"],
        terrain: Terrain,
    ) -> Float[Tensor, "*B I"]:
        present = select_present(self.vehicle, actuators, control)
        columns = [state[..., 3:], present, normal, unknown_normals(terrain), force]
        return torch.cat(columns + ([terrain.latent.flatten(-2)] if self.codes else []), dim=-1)


def _compressing(vehicle: Vehicle) -> Hybrid:
    return Hybrid(vehicle, encoder=Compressor(vehicle.read, size=vehicle.codes))


register_model("b-hindsight", draw=hindsight_throughout, colour="#7fb8e6")(Hybrid)


@register_model("df", colour="#d55e00", what="b that reads features of the ground")
def direct(vehicle: Vehicle) -> Hybrid:
    """Terrain features straight in."""
    return Hybrid(vehicle, encoder=Identity(vehicle.read))


@register_model("cf", colour="#009e73", what="b that reads features of the ground, compressed")
def compressed(vehicle: Vehicle) -> Hybrid:
    """Compressed terrain features, trained on hindsight."""
    return _compressing(vehicle)


@register_model(
    "dc",
    draw=per_trajectory,
    colour="#7b3fa0",
    display_name="visual",
    what="cf trained on ground seen from all distances",
)
def compressed_distance_independent(vehicle: Vehicle) -> Hybrid:
    """Compressed terrain features, trained on a random feature set for each trajectory."""
    return _compressing(vehicle)


def parametric_forces(
    vehicle: Vehicle,
    constants: Constants,
    state: Float[Tensor, "*B 6"],
    actuators: Float[Tensor, "*B A"],
    control: Float[Tensor, "*B U"],
    normal: Float[Tensor, "*B 3"],
) -> Float[Tensor, "*B 4"]:
    """The force vector F (eq. 1) on batches."""
    train = drive_train(vehicle, state, actuators, control)
    _, _, _, vx, vy, yaw_rate = state.unbind(-1)
    read = train.brake, train.steer, train.engine, train.throttle, train.gear
    force = forces(vx, vy, yaw_rate, *read, normal[..., 2], constants, TORCH)
    return torch.stack(force, dim=-1)


def advance(
    vehicle: Vehicle,
    constants: Constants,
    state: Float[Tensor, "B 6"],
    actuators: Float[Tensor, "B A"],
    control: Float[Tensor, "B U"],
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
