"""Interface of all dynamics models, and the rollout that training, evaluation and planning share."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.core.state import History, ModelState, Terrain, TerrainSource, Trajectory
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.torch_physics import BicycleConstants
from offpiste.dynamics.vehicle import Vehicle

Step = Callable[[ModelState, Tensor, Terrain], ModelState]


class KernelParts(NamedTuple):
    """Parts of a model that the generated kernels step, besides its actuators.

    Attributes:
        compensator: network that corrects the bicycle's forces; None if there is none.
        force_scale: units of the network's outputs.
    """

    bicycle: BicycleConstants
    compensator: Compensator | None = None
    force_scale: Float[Tensor, " 4"] | None = None


class Dynamics(nn.Module, ABC):
    """Model of the vehicle's motion, batched, on any device and in any float type. Subclasses are final.

    The defaults are those of a model without networks, features and kernels.

    Attributes:
        encoder: encoder of terrain features into the codes that the model reads; None if it reads no features.
        actuators: delay models, fitted before the model itself; None if it has none.
        reads_terrain: whether predictions depend on the ground.
    """

    vehicle: Vehicle
    encoder: FeatureEncoder | None
    actuators: Actuators | None
    reads_terrain: ClassVar[bool] = True

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self.vehicle = vehicle
        self.encoder = None
        self.actuators = None

    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """Return the model state at the start of a prediction; here only the actuators' residuals are recurrent.

        Args:
            history: rows before the start.
            state, actuators: at the start (row t).
        """
        recurrent = state[:, :0] if self.actuators is None else self.actuators.start(history)
        return ModelState(state, actuators, recurrent)

    @abstractmethod
    def stepper(self) -> Step:
        """Return the step function of a rollout; what stays constant during the rollout is computed once here."""

    def step(self, model_state: ModelState, control: Float[Tensor, "B U"], terrain: Terrain) -> ModelState:
        """Return the model state after one step of `conventions.DT`.

        Args:
            control: commands during the step (`Vehicle.control_columns`).
            terrain: ground under each wheel; fields are [B, 4, ...].
        """
        return self.stepper()(model_state, control, terrain)

    @property
    def codes(self) -> int:
        """Length of the code that the model reads under each wheel."""
        return self.encoder.size if self.encoder is not None else 0

    @property
    def recurrent_size(self) -> int:
        """Length of the recurrent states of all networks together."""
        return sum(module.state_size for module in self.modules() if isinstance(module, Compensator))

    def kernel_parts(self) -> KernelParts | None:
        """Return the parts that the generated kernels step; None if they cannot step this model."""
        return None

    def physics(self) -> "Dynamics | None":
        """Return the same model without networks, which is fitted first; None if there is nothing to fit first."""
        return None

    def adopt_physics(self, fitted: "Dynamics", *, learns: bool = False) -> None:
        """Copy the fitted parameters of the model from `physics`; they are frozen unless `learns`."""

    def standardise_on(self, history: History) -> None:
        """Set mean and scale of the networks' inputs from training windows with encoded features."""


def rollout(
    dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T U"], source: TerrainSource
) -> Trajectory:
    """Predict T steps.

    Args:
        model_state: from `dynamics.start`.
        controls: commands during each step.
        source: ground under the wheels, read before each step.
    """
    step = dynamics.stepper()
    states, actuators = [], []
    for t, control in enumerate(controls.unbind(dim=1)):
        model_state = step(model_state, control, source.at(t, model_state.state))
        states.append(model_state.state)
        actuators.append(model_state.actuators)
    return Trajectory(torch.stack(states, dim=1), torch.stack(actuators, dim=1))


def as_callable(
    dynamics: Dynamics, source: TerrainSource
) -> Callable[[Float[Tensor, "B P"], Float[Tensor, "B U"], int], Float[Tensor, "B P"]]:
    """Return the model as pytorch_mppi expects it: a function of packed model state, control and t."""
    step = dynamics.stepper()

    def call(packed: Tensor, control: Tensor, t: int = 0) -> Tensor:
        model_state = ModelState.unpack(packed, len(dynamics.vehicle.actuator_columns))
        return step(model_state, control, source.at(t, model_state.state)).pack()

    return call
