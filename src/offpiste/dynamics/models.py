"""Registry of dynamics models by name."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, TypeVar

import torch

from offpiste.core.errors import RunError
from offpiste.core.registry import Registry
from offpiste.dataset.feature_sets import Draw, hindsight, hindsight_throughout
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.vehicle import Vehicle

Build = TypeVar("Build", bound=Callable[[Vehicle], Dynamics])


@dataclass(frozen=True)
class Model:
    """Entry of the registry.

    Attributes:
        build: constructor of an untrained model.
        draw: feature sets of training windows, in addition to those drawn for their normals.
        baseline: whether it is evaluated beside every trained model; only its actuators are trained.
        colour: colour in figures; "" for a spare one.
        display_name: name in tables, figures and reports; "" for the registered name.
        what: short description for reports; "" for none.
        fits: whether the model supports a vehicle.
    """

    build: Callable[[Vehicle], Dynamics]
    draw: Draw = hindsight
    baseline: bool = False
    colour: str = ""
    display_name: str = ""
    what: str = ""
    fits: Callable[[Vehicle], bool] = lambda vehicle: True

    @property
    def needs_sets(self) -> bool:
        """Whether training needs feature sets by distance in the dataset."""
        return self.draw not in (hindsight, hindsight_throughout)

    def __call__(self, vehicle: Vehicle, *, seed: int) -> Dynamics:
        """Return an untrained model of this vehicle; its initial weights depend only on the seed."""
        with seeded(seed):
            return self.build(vehicle)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed the initial weights of networks that are constructed in this context."""
    # Layers of torch can only draw from the global generator, whose state is restored.
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)
        yield


MODELS: Final[Registry[Model]] = Registry("model", package="offpiste.dynamics", error=RunError)
"""Models by their names in docs/method.md and the paper."""


def register_model(
    name: str,
    *,
    draw: Draw = hindsight,
    baseline: bool = False,
    colour: str = "",
    display_name: str = "",
    what: str = "",
    fits: Callable[[Vehicle], bool] = lambda vehicle: True,
) -> Callable[[Build], Build]:
    """Register the decorated class or function, which constructs a model from a `Vehicle` (arguments: see `Model`).

    Raises:
        RunError: the name is taken.
    """

    def add(build: Build) -> Build:
        MODELS.register(name)(Model(build, draw, baseline, colour, display_name, what, fits))
        return build

    return add


def initial_actuators(vehicle: Vehicle, seed: int) -> Actuators:
    """Return unfitted delay models; their initial weights are the same for all models of a vehicle and seed."""
    with seeded(seed):
        return Actuators(vehicle)


def reference_of(vehicle: Vehicle) -> str:
    """Return the name of the model whose errors scale the loss: `kinematic`, or `ctrv` if the vehicle cannot steer."""
    return "kinematic" if MODELS["kinematic"].fits(vehicle) else "ctrv"


def is_baseline(name: str) -> bool:
    """Return whether a registered model of this name is evaluated beside every trained model."""
    return name in MODELS and MODELS[name].baseline


def display_name(name: str) -> str:
    """Return the name of a model for tables, figures and reports."""
    return (name in MODELS and MODELS[name].display_name) or name
