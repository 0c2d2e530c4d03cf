"""What the kernels read of a model, as arrays: a record, the vector of constants, three networks."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import ACTUATORS, CONTROL
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.base import Dynamics, KernelParts
from offpiste.dynamics.inputs import unknown_normals
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.network import Weights, network, weights
from offpiste.dynamics.kernels.rollout import Networks, Record
from offpiste.dynamics.vehicle import Vehicle
from offpiste.state import Terrain


class Given(NamedTuple):
    """Arguments of the kernels.

    Attributes:
        start: packed model states [B, P].
        record: see `Record`.
        constants: in the order of `layout.CONSTANTS`.
        networks: of the forces, the brake and the steering.
        differentiate: will there be a backward pass?
    """

    start: np.ndarray
    record: Record
    constants: np.ndarray
    networks: Networks
    differentiate: bool


def record(
    vehicle: Vehicle,
    controls: Float[Tensor, "B T U"],
    terrain: Terrain,
    codes: Float[Tensor, "B T C"],
) -> Record:
    """What the rollout is given."""
    recorded = [*(name in vehicle.actuators for name in ACTUATORS), *(name in vehicle.control for name in CONTROL)]
    tensors = controls, terrain.normal, unknown_normals(terrain), codes
    commanded, normals, unknown, read = (tensor.detach().contiguous().numpy() for tensor in tensors)
    return Record(commanded, normals, unknown, read, np.array(recorded))


def kernel_parts(dynamics: Dynamics) -> tuple[KernelParts, Actuators]:
    """What the kernels step of a model.

    Raises:
        ValueError: they cannot step it.
    """
    parts = dynamics.kernel_parts()
    if parts is None or dynamics.actuators is None:
        raise ValueError("no kernels for this model; see `supports`")
    return parts, dynamics.actuators


def learned_constants(dynamics: Dynamics) -> Float[Tensor, " K"]:
    """The bicycle's constants, differentiable (`layout.LEARNED`)."""
    return torch.stack(kernel_parts(dynamics)[0].bicycle())


def compensator_weights(dynamics: Dynamics) -> Weights:
    """Weights of the network that corrects the forces, differentiable."""
    parts, _ = kernel_parts(dynamics)
    return weights(parts.compensator, parts.force_scale)


def constants(dynamics: Dynamics, learned: Float[Tensor, " K"]) -> np.ndarray:
    """The vector of `layout.CONSTANTS`, from the bicycle's."""
    vehicle, (_, actuators) = dynamics.vehicle, kernel_parts(dynamics)
    switches: dict[str, float] = {
        **{f"{name}_measured": actuator in vehicle.actuators for name, actuator in layout.MEASURED.items()},
        **{f"{one.label}_lags": one.steps(vehicle) for one in layout.LAGGING},
        "max_steer": vehicle.max_steer,
    }
    with torch.no_grad():
        lags = actuators.flat_constants()
    parts = learned.detach().numpy(), lags.numpy(), [switches[name] for name in layout.SWITCHES]
    return np.concatenate(parts, dtype=np.float32)


def networks(dynamics: Dynamics, compensator: Weights) -> Networks:
    """The networks of the forces, the brake and the steering; their recurrent states follow each other in this order.

    Args:
        compensator: the first one's weights.
    """
    vehicle, (parts, actuators) = dynamics.vehicle, kernel_parts(dynamics)
    seen = [
        *layout.STEPPED[3:6],
        *(name for name in ACTUATORS if name in vehicle.actuators),
        *(row for row, name in zip(layout.CONTROLS, CONTROL, strict=True) if name in vehicle.control),
        *layout.BODY_NORMAL,
        *layout.UNKNOWN,
        *layout.FORCE,
    ]
    first = network(
        parts.compensator,
        compensator,
        inputs=[*(layout.ROW[name] for name in seen), *range(len(layout.ROWS), len(layout.ROWS) + 4 * dynamics.codes)],
        first_hidden=0,
        first_output=layout.ROW[layout.CORRECTION[0]],
    )
    hidden = layout.HIDDEN if parts.compensator is not None else 0
    residuals = []
    for one in layout.LAGGING:
        if one.lag.residual:
            result = actuators.networks.get(one.label)
            command = layout.CONTROLS[CONTROL.index(one.actuator.follows)]
            residuals.append(
                network(
                    result,
                    weights(result),
                    inputs=[layout.ROW[row] for row in (*one.columns, command, "vx")],
                    first_hidden=hidden,
                    first_output=layout.ROW[f"{one.label}_residual"],
                )
            )
            hidden += layout.HIDDEN if result is not None else 0
    brake, steer = residuals
    return first, brake, steer
