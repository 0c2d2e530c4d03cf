"""The interface of every dynamics model, and the rollout that training, evaluation and planning share."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.core.state import History, ModelState, Terrain, TerrainSource, Trajectory
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.bicycle import BicycleConstants
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.dynamics.lstm import Compensator
from offpiste.dynamics.vehicle import Vehicle

Step = Callable[[ModelState, Tensor, Terrain], ModelState]


class KernelParts(NamedTuple):
    """Parts of a model that the generated kernels step, besides its actuators.

    Attributes:
        bicycle: constants of the parametric bicycle.
        compensator: network that corrects the bicycle's forces; None without.
        force_scale: units of the network's outputs.
    """

    bicycle: BicycleConstants
    compensator: Compensator | None = None
    force_scale: Float[Tensor, " 4"] | None = None


class Dynamics(nn.Module, ABC):
    """A model of how the vehicle moves, batched, on any device and in any float type. Subclasses are final.

    What a model can do, and what others must do for it, it declares here; the defaults are those of a model without
    networks, features and kernels.

    Attributes:
        encoder: turns terrain features into the codes that the model reads; None if it reads no features.
        actuators: delay models, fitted before the model itself; None if it has none.
        reads_terrain: whether predictions depend on the ground at all.
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

    @abstractmethod
    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B A"]) -> ModelState:
        """What the model remembers at the start of a prediction.

        Args:
            history: the rows before the start.
            state, actuators: at the start (row t).
        """

    @abstractmethod
    def stepper(self) -> Step:
        """A step with everything that does not change along a rollout computed once."""

    def step(self, model_state: ModelState, control: Float[Tensor, "B U"], terrain: Terrain) -> ModelState:
        """One step of `conventions.DT`.

        Args:
            control: as commanded during the step (`Vehicle.control_columns`).
            terrain: under each wheel now; fields are [B, 4, ...].
        """
        return self.stepper()(model_state, control, terrain)

    @property
    def codes(self) -> int:
        """Length of the code that the model reads under each wheel."""
        return self.encoder.size if self.encoder is not None else 0

    @property
    def recurrent_size(self) -> int:
        """Hidden units of all its networks: the width of `ModelState.hidden` and `ModelState.cell`."""
        return self.actuators.hidden if self.actuators is not None else 0

    def kernel_parts(self) -> KernelParts | None:
        """Parts that the generated kernels step; None if they cannot step this model."""
        return None

    def physics(self) -> "Dynamics | None":
        """The same model without networks, which is fitted first; None if there is nothing to fit first."""
        return None

    def adopt_physics(self, fitted: "Dynamics", *, learns: bool = False) -> None:
        """Take over the parameters of what `physics` returned, once they are fitted; they learn no more by default."""

    def standardise_on(self, history: History) -> None:
        """Set mean and scale of the inputs of the model's networks from training windows, their codes included."""


def rollout(
    dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T U"], source: TerrainSource
) -> Trajectory:
    """Predict T steps.

    Args:
        model_state: from `dynamics.start`.
        controls: as commanded during each step.
        source: asked for the ground under the wheels before each step.
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
    """The model as pytorch_mppi and similar planners want it: `f(packed model state, control, t)` -> the next one."""
    step = dynamics.stepper()

    def call(packed: Tensor, control: Tensor, t: int = 0) -> Tensor:
        model_state = ModelState.unpack(packed, len(dynamics.vehicle.actuator_columns))
        return step(model_state, control, source.at(t, model_state.state)).pack()

    return call
