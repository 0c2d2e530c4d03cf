"""Parametric bicycle, and the hybrid model whose recurrent network corrects the bicycle's forces (paper, eq. 5)."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.state import History, ModelState, Terrain
from offpiste.dataset.feature_sets import hindsight_throughout, per_trajectory
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.base import Dynamics, KernelParts, Step
from offpiste.dynamics.feature_encoder import Compressor, FeatureEncoder, Identity
from offpiste.dynamics.lstm import LSTM, Cell, Compensator
from offpiste.dynamics.models import register_model
from offpiste.dynamics.torch_physics import (
    UNKNOWN,
    BicycleConstants,
    advance,
    drive_train,
    mean_normal,
    parametric_forces,
    select_present,
    unknown_normals,
)
from offpiste.dynamics.vehicle import Vehicle


@register_model("parametric", colour="#56b4e9", what="actuator lags and a bicycle with fitted constants")
class Parametric(Dynamics):
    """Actuator lags and the bicycle; only constants are learned (`parametric`).

    Args:
        actuators: delay models; new ones by default.
    """

    actuators: Actuators

    def __init__(self, vehicle: Vehicle, actuators: Actuators | None = None) -> None:
        super().__init__(vehicle)
        self.actuators = actuators or Actuators(vehicle)
        self.bicycle = BicycleConstants(vehicle)

    def stepper(self) -> Step:
        """Step by parametric forces, rates and forward Euler."""
        lags, constants = self.actuators.constants(), self.bicycle()

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            state, actuators = model_state.state, model_state.actuators
            normal, inputs = mean_normal(terrain, state[:, 2]), drive_train(self.vehicle, state, actuators, control)
            force = parametric_forces(constants, state, inputs, normal)
            after = advance(constants, state, inputs.steer, normal, force)
            return ModelState(after, *self.actuators.step(lags, actuators, control, state[:, 3], model_state.recurrent))

        return step

    def kernel_parts(self) -> KernelParts:
        """Return the bicycle."""
        return KernelParts(self.bicycle)


@register_model(
    "b", colour="#0072b2", display_name="blind", what="parametric, corrected by a network that does not see the ground"
)
class Hybrid(Dynamics):
    """Bicycle with a network that corrects its force vector, without (`b`) or with encoded terrain features.

    The network reads vx, vy, yaw rate, recorded actuators and controls, the mean normal, the fraction of unknown
    normals, the parametric forces and the codes of the four wheels; never position or yaw.

    Args:
        encoder: encoder of the terrain features; None for `b`.
        cell: recurrent cell of the network (`offpiste.dynamics.lstm.Cell`).
    """

    actuators: Actuators

    def __init__(
        self, vehicle: Vehicle, *, encoder: FeatureEncoder | None = None, cell: Callable[[int, int], Cell] = LSTM
    ) -> None:
        super().__init__(vehicle)
        self.encoder = encoder
        self.actuators = Actuators(vehicle)
        self.bicycle = BicycleConstants(vehicle)
        before = 3 + len(vehicle.actuators) + len(vehicle.control) + 3
        self.unknown = slice(before, before + UNKNOWN)
        inputs = before + UNKNOWN + 4 + 4 * self.codes
        self.compensator = Compensator(inputs, 4, cell=cell)
        self.force_scale: Tensor
        # An output of 1 is an acceleration of the vehicle of 1 m/s^2, or a yaw acceleration of 1 rad/s^2.
        self.register_buffer("force_scale", torch.tensor([vehicle.mass / 2, vehicle.mass, vehicle.mass, 1.0]))

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """Initialise the networks from the last 0.2 s."""
        own, begun = self.compensator.start(self.recorded_inputs(history)), super().start(history, state, actuators)
        return replace(begun, recurrent=torch.cat((own, begun.recurrent), dim=-1))

    def stepper(self) -> Step:
        """Step by parametric forces, their correction, rates and forward Euler."""
        lags, constants = self.actuators.constants(), self.bicycle()
        sizes = self.compensator.state_size, self.actuators.recurrent_size

        def step(model_state: ModelState, control: Tensor, terrain: Terrain) -> ModelState:
            state, actuators = model_state.state, model_state.actuators
            own, of_lags = model_state.recurrent.split(sizes, dim=-1)
            normal, inputs = mean_normal(terrain, state[:, 2]), drive_train(self.vehicle, state, actuators, control)
            force = parametric_forces(constants, state, inputs, normal)
            correction, own = self.compensator(self._inputs(state, actuators, control, normal, force, terrain), own)
            force = force + correction * self.force_scale
            after = advance(constants, state, inputs.steer, normal, force)
            actuators, of_lags = self.actuators.step(lags, actuators, control, state[:, 3], of_lags)
            return ModelState(after, actuators, torch.cat((own, of_lags), dim=-1))

        return step

    def standardise_on(self, history: History) -> None:
        """Set mean and scale of the network's inputs, and the range of all except the codes."""
        inputs = self.recorded_inputs(history).flatten(0, 1)
        self.compensator.standardise_on(inputs, self.unknown, ranged=inputs.shape[-1] - 4 * self.codes)

    def kernel_parts(self) -> KernelParts:
        """Return the bicycle and the network that corrects its forces."""
        return KernelParts(self.bicycle, self.compensator, self.force_scale)

    def physics(self) -> Parametric:
        """Return an unfitted bicycle with a copy of the actuators, on the same device."""
        return Parametric(self.vehicle, deepcopy(self.actuators)).to(self.bicycle.raw.device)

    def adopt_physics(self, fitted: Dynamics, *, learns: bool = False) -> None:
        """Copy the bicycle's constants; they are frozen unless `learns`."""
        parts = fitted.kernel_parts()
        assert parts is not None
        self.bicycle.load_state_dict(parts.bicycle.state_dict())
        self.bicycle.requires_grad_(learns)

    def recorded_inputs(self, history: History) -> Float[Tensor, "B H I"]:
        """Return the network's inputs at recorded rows."""
        state, actuators, control = history.state, history.actuators, history.control
        normal = mean_normal(history.terrain, state[..., 2])
        inputs = drive_train(self.vehicle, state, actuators, control)
        force = parametric_forces(self.bicycle(), state, inputs, normal)
        return self._inputs(state, actuators, control, normal, force, history.terrain)

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


register_model("b-hindsight", draw=hindsight_throughout, colour="#7fb8e6")(Hybrid)


@register_model("df", colour="#d55e00", what="b that reads features of the ground")
def direct(vehicle: Vehicle) -> Hybrid:
    """Return the hybrid model with unencoded terrain features."""
    return Hybrid(vehicle, encoder=Identity(vehicle.read))


@register_model(
    "dc",
    draw=per_trajectory,
    colour="#7b3fa0",
    display_name="visual",
    what="cf trained on ground seen from all distances",
)
@register_model("cf", colour="#009e73", what="b that reads features of the ground, compressed")
def compressed(vehicle: Vehicle) -> Hybrid:
    """Return the hybrid model with compressed terrain features."""
    return Hybrid(vehicle, encoder=Compressor(vehicle.read, size=vehicle.codes))
