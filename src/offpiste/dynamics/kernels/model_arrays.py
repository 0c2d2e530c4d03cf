"""What the kernels read of a model, as arrays: a record, the vector of constants, three networks."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import ACTUATORS, CONTROL
from offpiste.dynamics.base import Vehicle
from offpiste.dynamics.hybrid import Hybrid, Parametric
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.network import Network, Weights, network, weights
from offpiste.dynamics.kernels.rollout import Record
from offpiste.dynamics.lstm import Compensator


class Given(NamedTuple):
    """Arguments of the kernels.

    Attributes:
        start: packed carries [B, P].
        record: see `Record`.
        constants: in the order of `layout.CONSTANTS`.
        networks: of the forces, the brake and the steering.
        differentiate: will there be a backward pass?
    """

    start: np.ndarray
    record: Record
    constants: np.ndarray
    networks: tuple[Network, Network, Network]
    differentiate: bool


def record(
    vehicle: Vehicle,
    controls: Float[Tensor, "B T 3"],
    normals: Float[Tensor, "B T 4 3"],
    codes: Float[Tensor, "B T C"],
) -> Record:
    """What the rollout is given."""
    recorded = [*(name in vehicle.actuators for name in ACTUATORS), *(name in vehicle.control for name in CONTROL)]
    controls, normals, codes = (tensor.detach().contiguous() for tensor in (controls, normals, codes))
    return Record(controls.numpy(), normals.numpy(), codes.numpy(), np.array(recorded))


def constants(dynamics: Parametric | Hybrid, learned: Float[Tensor, " K"]) -> np.ndarray:
    """The vector of `layout.CONSTANTS`, from the bicycle's."""
    vehicle = dynamics.vehicle
    switches = {
        "brake_measured": "brake" in vehicle.actuators,
        "steer_measured": "steer" in vehicle.actuators,
        "engine_measured": "engine_rpm" in vehicle.actuators,
        "brake_lags": "brake" in vehicle.actuators and "brake" in vehicle.control,
        "steer_lags": "steer" in vehicle.actuators and "steer" in vehicle.control,
        "engine_lags": "engine_rpm" in vehicle.actuators and "throttle" in vehicle.control,
        "max_steer": vehicle.max_steer,
    }
    with torch.no_grad():
        lags = torch.stack(dynamics.actuators.constants())
    parts = learned.detach().numpy(), lags.numpy(), [switches[name] for name in layout.SWITCHES]
    return np.concatenate(parts, dtype=np.float32)


def networks(dynamics: Parametric | Hybrid, compensator: Weights) -> tuple[Network, Network, Network]:
    """The networks of the forces, the brake and the steering; their recurrent states follow each other in this order.

    Args:
        compensator: the first one's weights.
    """
    vehicle = dynamics.vehicle
    seen = [
        *layout.CARRIED[3:6],
        *(name for name in ACTUATORS if name in vehicle.actuators),
        *(row for row, name in zip(layout.CONTROLS, CONTROL, strict=True) if name in vehicle.control),
        *layout.BODY_NORMAL,
        *layout.FORCE,
    ]
    codes = dynamics.codes if isinstance(dynamics, Hybrid) else 0
    first = network(
        dynamics.compensator if isinstance(dynamics, Hybrid) else None,
        compensator,
        inputs=[*(layout.ROW[name] for name in seen), *range(len(layout.ROWS), len(layout.ROWS) + 4 * codes)],
        first_hidden=0,
        first_output=layout.ROW[layout.CORRECTION[0]],
    )
    hidden = layout.HIDDEN if isinstance(dynamics, Hybrid) else 0
    brake = _residual(dynamics, "brake", ("brake", "brake_command", "vx"), hidden)
    hidden += layout.HIDDEN if len(brake.outer) else 0
    return first, brake, _residual(dynamics, "steer", ("steer", "steer_rate", "steer_command", "vx"), hidden)


def _residual(dynamics: Parametric | Hybrid, name: str, seen: tuple[str, ...], first_hidden: int) -> Network:
    found = dict(dynamics.actuators.residuals.items()).get(name)
    assert found is None or isinstance(found, Compensator)
    return network(
        found,
        weights(found),
        inputs=[layout.ROW[row] for row in seen],
        first_hidden=first_hidden,
        first_output=layout.ROW[f"{name}_residual"],
    )
