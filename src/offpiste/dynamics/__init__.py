"""Batched dynamics models with one interface, for any device and float type."""

from offpiste.dynamics.base import Dynamics, as_callable, rollout
from offpiste.dynamics.baselines import ConstantMotion, Kinematic, Recurrent
from offpiste.dynamics.hybrid import Hybrid, Parametric
from offpiste.dynamics.models import MODELS, register_model
from offpiste.dynamics.vehicle import Vehicle

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
    "register_model",
    "rollout",
]
