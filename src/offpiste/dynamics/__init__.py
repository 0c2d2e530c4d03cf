"""Dynamics models: one interface, all batched, any device and float type."""

from offpiste.dynamics.base import Dynamics, Vehicle, as_callable, rollout
from offpiste.dynamics.baselines import ConstantMotion, Kinematic, Recurrent
from offpiste.dynamics.hybrid import Hybrid, Parametric

MODELS: dict[str, type[ConstantMotion] | type[Kinematic] | type[Recurrent] | type[Parametric] | type[Hybrid]] = {
    "ctrv": ConstantMotion,
    "kinematic": Kinematic,
    "lstm": Recurrent,
    "parametric": Parametric,
    "b": Hybrid,
}
"""Models by the names of DESIGN.md and the paper; each is built from a `Vehicle`."""

__all__ = [
    "MODELS",
    "ConstantMotion",
    "Dynamics",
    "Hybrid",
    "Kinematic",
    "Parametric",
    "Recurrent",
    "Vehicle",
    "as_callable",
    "rollout",
]
