"""The interface of every dynamics model, and the rollout that training, evaluation and planning share."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.state import History, ModelState, Terrain, TerrainSource, Trajectory

Step = Callable[[ModelState, Tensor, Terrain], ModelState]


@dataclass(frozen=True)
class Vehicle:
    """What a model must know of the vehicle and of its log.

    Attributes:
        mass: [kg].
        wheelbase: [m].
        max_steer: road-wheel angle at a steering command of 1 [rad].
        control: names (of `conventions.CONTROL`) that the log has.
        actuators: names (of `conventions.ACTUATORS`) that the log has; "steer" only together with "steer_rate".
        rear_axle: how far behind the pose point the rear axle lies [m].
        features: how many terrain features the dataset has under each wheel.
        pca: how many of them a model reads, the first ones; 0: all.
        codes: length of the code that an encoder makes of them.
    """

    mass: float
    wheelbase: float
    max_steer: float
    control: tuple[str, ...]
    actuators: tuple[str, ...]
    rear_axle: float = 0.0
    features: int = 0
    pca: int = 0
    codes: int = 4

    def __post_init__(self) -> None:
        if "steer" in self.actuators and "steer_rate" not in self.actuators:
            raise ValueError("a steering angle needs its rate: the delay model has both as its state")

    @property
    def read(self) -> int:
        """How many terrain features a model reads."""
        return self.pca or self.features


class Dynamics(nn.Module, ABC):
    """A model of how the vehicle moves. Subclasses are final; all are batched and run on any device and float type."""

    vehicle: Vehicle

    @abstractmethod
    def start(self, history: History, state: Float[Tensor, "B 6"], actuators: Float[Tensor, "B 4"]) -> ModelState:
        """What the model remembers at the start of a prediction.

        Args:
            history: the rows before the start.
            state, actuators: at the start (row t).
        """

    @abstractmethod
    def stepper(self) -> Step:
        """A step with everything that does not change along a rollout computed once."""

    def step(self, model_state: ModelState, control: Float[Tensor, "B 3"], terrain: Terrain) -> ModelState:
        """One step of `conventions.DT`.

        Args:
            control: throttle, brake, steer as commanded during the step.
            terrain: under each wheel now; fields are [B, 4, ...].
        """
        return self.stepper()(model_state, control, terrain)


def rollout(
    dynamics: Dynamics, model_state: ModelState, controls: Float[Tensor, "B T 3"], source: TerrainSource
) -> Trajectory:
    """Predict T steps.

    Args:
        carry: from `dynamics.start`.
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
) -> Callable[[Float[Tensor, "B P"], Float[Tensor, "B 3"], int], Float[Tensor, "B P"]]:
    """The model as `f(packed carry, control, t) -> packed carry`, as pytorch_mppi and similar planners want it."""
    step = dynamics.stepper()

    def call(packed: Float[Tensor, "B P"], control: Float[Tensor, "B 3"], t: int = 0) -> Float[Tensor, "B P"]:
        model_state = ModelState.unpack(packed)
        return step(model_state, control, source.at(t, model_state.state)).pack()

    return call
