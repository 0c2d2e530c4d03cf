"""Dynamics models: one interface, all batched, any device and float type."""

from collections.abc import Callable

from offpiste.dynamics.base import Dynamics, Vehicle, as_callable, rollout
from offpiste.dynamics.baselines import ConstantMotion, Kinematic, Recurrent
from offpiste.dynamics.encoder import Compressor, Identity
from offpiste.dynamics.hybrid import Hybrid, Parametric

MODELS: dict[str, Callable[[Vehicle], Dynamics]] = {
    "ctrv": ConstantMotion,
    "kinematic": Kinematic,
    "lstm": Recurrent,
    "parametric": Parametric,
    "b": Hybrid,
    "b-history": lambda vehicle: Hybrid(vehicle, history=64),
    "b-wide": lambda vehicle: Hybrid(vehicle, history=34, width=96),
    "df": lambda vehicle: Hybrid(vehicle, encoder=Identity(vehicle.read)),
    "cf": lambda vehicle: Hybrid(vehicle, encoder=Compressor(vehicle.read, size=vehicle.codes)),
    "dc": lambda vehicle: Hybrid(vehicle, encoder=Compressor(vehicle.read, size=vehicle.codes)),
    "dc-step": lambda vehicle: Hybrid(vehicle, encoder=Compressor(vehicle.read, size=vehicle.codes)),
    "cf-masked": lambda vehicle: Hybrid(vehicle, encoder=Compressor(vehicle.read, size=vehicle.codes)),
    "hold": lambda vehicle: Hybrid(vehicle, encoder=Identity(vehicle.read), holds=True),
    "dc-hold": lambda vehicle: Hybrid(vehicle, encoder=Compressor(vehicle.read, size=vehicle.codes), holds=True),
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
