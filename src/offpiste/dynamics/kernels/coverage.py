"""Which models the generated kernels cover: exact module types and shapes, for the CPU, GPUs and exports alike.

Subclasses and modules with hooks are not covered, because they may compute something else.
"""

import logging
from collections.abc import Sequence
from functools import cache
from typing import Final

from torch import nn

from offpiste.core.conventions import ACTUATORS
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.feature_encoder import Compressor, FeatureEncoder, Identity
from offpiste.dynamics.hybrid import Hybrid, Parametric
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.networks import linear_layers
from offpiste.dynamics.lstm import LSTM, Compensator
from offpiste.dynamics.torch_physics import BicycleConstants
from offpiste.dynamics.vehicle import Vehicle

logger = logging.getLogger(__name__)

EAGER_COST: Final = "20 times slower in training, about 50 times in planning"
"""Time of eager steps relative to the kernels (docs/results.md)."""

_HOOKS: Final = ("_forward_hooks", "_forward_pre_hooks", "_backward_hooks", "_backward_pre_hooks")


def uncovered(dynamics: Dynamics) -> str:
    """Return why the kernels do not cover the steps of a model; empty if they do. They read codes of any encoder."""
    parts, actuators = dynamics.kernel_parts(), dynamics.actuators
    if parts is None or actuators is None:
        return "it declares no parts for them"
    # A subclass may step otherwise only once it has trained, which no comparison before shows.
    if reason := _not_exactly(dynamics, Hybrid if isinstance(dynamics, Hybrid) else Parametric):
        return reason
    network = "" if parts.compensator is None else uncovered_network(parts.compensator)
    return _not_exactly(parts.bicycle, BicycleConstants) or network or uncovered_actuators(actuators)


def uncovered_actuators(actuators: Actuators) -> str:
    """Return why the kernels do not cover the models of the actuators; empty if they do."""
    if names := unknown_channels(actuators.vehicle):
        return f"they do not know {', '.join(names)}"
    reasons = (uncovered_network(network) for network in actuators.residuals.values())
    return _not_exactly(actuators, Actuators) or next(filter(None, reasons), "")


def uncovered_network(network: nn.Module) -> str:
    """Return why the kernels do not cover a recurrent network; empty if they do."""
    if reason := _not_exactly(network, Compensator):
        return reason
    assert isinstance(network, Compensator)
    if reason := _not_exactly(network.cell, LSTM) or _not_exactly(network.init_cell, nn.LSTM):
        return reason
    cell, first = network.cell, network.init_cell
    assert isinstance(cell, LSTM)
    if cell.hidden_size != layout.HIDDEN:
        return f"its LSTM has {cell.hidden_size} units, theirs {layout.HIDDEN}"
    if not cell.bias or (first.num_layers, first.proj_size, first.bidirectional, first.bias) != (1, 0, False, True):
        return "its LSTMs have other biases, layers or projections"
    return _not_layers(network.output, 2) or _not_layers(network.init_output, 2)


def uncovered_encoder(encoder: FeatureEncoder | None) -> str:
    """Return why the kernels do not cover an encoder; empty if they do, or if there is none."""
    if encoder is None:
        return ""
    if isinstance(encoder, Compressor):
        return _not_exactly(encoder, Compressor) or _not_layers(encoder.layers, 3) or _not_widths(encoder)
    if isinstance(encoder, Identity):
        return _not_exactly(encoder, Identity)
    return f"its encoder is a {type(encoder).__name__}"


def unknown_channels(vehicle: Vehicle) -> Sequence[str]:
    """Return the dataset columns of a vehicle that the kernels do not know."""
    commands = layout.COMMANDS[: len(vehicle.control_columns)]
    if vehicle.actuator_columns == ACTUATORS and vehicle.control_columns == commands:
        return ()
    known = (*ACTUATORS, *layout.COMMANDS)
    columns = (*vehicle.actuator_columns, *vehicle.control_columns)
    return [name for name in columns if name not in known] or columns


@cache
def warn_of_eager_steps(model: str, reason: str) -> None:
    """Warn once a process that a model is stepped without kernels."""
    logger.warning(f"the kernels do not cover {model} ({reason}): it is stepped eagerly, {EAGER_COST}")


def _not_exactly(module: object, kind: type) -> str:
    """Return how a module differs from an instance of exactly this type without hooks; empty if it does not."""
    methods = _methods(kind)
    if type(module) is not kind:
        return f"its {kind.__name__} is a {type(module).__name__}"
    if replaced := methods & vars(module).keys():
        return f"its {kind.__name__} has another {min(replaced)}"
    # PyTorch has no public way to ask for hooks.
    return f"its {kind.__name__} has hooks" if any(getattr(module, hooks) for hooks in _HOOKS) else ""


@cache
def _methods(kind: type) -> frozenset[str]:
    return frozenset(name for name in dir(kind) if callable(getattr(kind, name)))


def _not_widths(encoder: Compressor) -> str:
    """Return which width of an encoder's layers the kernels do not read; empty if there is none."""
    first, second, last = linear_layers(encoder.layers)
    if first.out_features % 4 or second.out_features % 4:
        return "its hidden layers have no multiple of 4 units"
    if last.out_features != encoder.size:
        return f"its last layer has {last.out_features} units in place of {encoder.size}"
    return ""


def _not_layers(layers: nn.Module, linear: int) -> str:
    """Return how a network differs from linear layers with tanh between them; empty if it does not."""
    kinds = [nn.Linear, *[nn.Tanh, nn.Linear] * (linear - 1)]
    if reason := _not_exactly(layers, nn.Sequential):
        return reason
    found = list(layers.children())
    if len(found) != len(kinds):
        return f"it has {len(found)} layers in place of {len(kinds)}"
    if any(isinstance(layer, nn.Linear) and layer.bias is None for layer in found):
        return "a linear layer has no bias"
    return next(filter(None, map(_not_exactly, found, kinds)), "")
