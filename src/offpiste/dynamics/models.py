"""Models by name: each registers itself where it is defined."""

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
    """What belongs to a model's name.

    Attributes:
        build: makes an untrained model.
        draw: feature sets that training windows read beside those drawn for their normals.
        baseline: whether it is evaluated beside every trained model; it has nothing to train but its actuators.
        colour: in figures; "" for one from the spare colours.
        display_name: in tables, figures and reports; "" for the registered name.
        what: it is, in a few words for reports; "" to say nothing.
        fits: whether the model can be made for a vehicle.
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
        """Whether it can train only where the dataset has feature sets by distance."""
        return self.draw not in (hindsight, hindsight_throughout)

    def __call__(self, vehicle: Vehicle, *, seed: int) -> Dynamics:
        """An untrained model of this vehicle, whose initial weights follow from the seed alone."""
        with seeded(seed):
            return self.build(vehicle)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Networks that are made inside draw their initial weights from this seed, and from nothing that came before."""
    # torch's layers draw from the global generator and take no other; it is left as it was.
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)
        yield


MODELS: Final[Registry[Model]] = Registry("model", package="offpiste.dynamics", error=RunError)
"""Models by the names of docs/method.md and the paper."""


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
    """Add the class or function below it, which makes a model from a `Vehicle`, under a name (see `Model`).

    Raises:
        RunError: the name is taken.
    """

    def add(build: Build) -> Build:
        MODELS.register(name)(Model(build, draw, baseline, colour, display_name, what, fits))
        return build

    return add


def initial_actuators(vehicle: Vehicle, seed: int) -> Actuators:
    """Delay models to be fitted, with the same initial weights for every model of a vehicle and seed."""
    with seeded(seed):
        return Actuators(vehicle)


def reference_of(vehicle: Vehicle) -> str:
    """Name of the model whose errors are the units of the loss: `kinematic`, or `ctrv` where nothing steers."""
    return "kinematic" if MODELS["kinematic"].fits(vehicle) else "ctrv"


def is_baseline(name: str) -> bool:
    """Whether a model of this name is evaluated beside every trained one; False for a name that is not registered."""
    return name in MODELS and MODELS[name].baseline


def display_name(name: str) -> str:
    """Return the name of a model for tables, figures and reports."""
    return (name in MODELS and MODELS[name].display_name) or name
