"""Models by name: each registers itself where it is defined."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeVar

from offpiste.dataset.feature_sets import Draw
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.vehicle import Vehicle
from offpiste.errors import RunError
from offpiste.registry import Registry

Build = TypeVar("Build", bound=Callable[[Vehicle], Dynamics])


@dataclass(frozen=True)
class Model:
    """What belongs to a model's name.

    Attributes:
        build: makes an untrained model.
        draw: feature sets that training windows read; None for hindsight alone.
        baseline: whether it is evaluated beside every trained model; it has nothing to train but its actuators.
        ablation: whether it answers a question about another model and is no candidate itself.
        colour: in figures; "" for one from the spare colours.
        fits: whether the model can be made for a vehicle.
    """

    build: Callable[[Vehicle], Dynamics]
    draw: Draw | None = None
    baseline: bool = False
    ablation: bool = False
    colour: str = ""
    fits: Callable[[Vehicle], bool] = lambda vehicle: True

    def __call__(self, vehicle: Vehicle) -> Dynamics:
        """An untrained model of this vehicle."""
        return self.build(vehicle)


MODELS: Final[Registry[Model]] = Registry("model", package="offpiste.dynamics", error=RunError)
"""Models by the names of docs/method.md and the paper."""


def register_model(
    name: str,
    *,
    draw: Draw | None = None,
    baseline: bool = False,
    ablation: bool = False,
    colour: str = "",
    fits: Callable[[Vehicle], bool] = lambda vehicle: True,
) -> Callable[[Build], Build]:
    """Add the class or function below it, which makes a model from a `Vehicle`, under a name (see `Model`).

    Raises:
        RunError: the name is taken.
    """

    def add(build: Build) -> Build:
        MODELS.register(name)(Model(build, draw, baseline, ablation, colour, fits))
        return build

    return add


def reference_of(vehicle: Vehicle) -> str:
    """Name of the model whose errors are the units of the loss: `kinematic`, or `ctrv` where nothing steers."""
    return "kinematic" if MODELS["kinematic"].fits(vehicle) else "ctrv"


def is_baseline(name: str) -> bool:
    """Whether a model of this name is evaluated beside every trained one; False for a name that is not registered."""
    return name in MODELS and MODELS[name].baseline
