"""What the kernels read of a model, as arrays: a record, the vector of constants, three networks."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from offpiste.core.conventions import ACTUATORS
from offpiste.core.state import ModelState, Terrain
from offpiste.dynamics.actuator_lags import Lagging
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.base import Dynamics, KernelParts
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.lanes import GIVEN, pack
from offpiste.dynamics.kernels.network import Network, Weights, network, weights, weights_apart
from offpiste.dynamics.kernels.rollout import Networks, Record
from offpiste.dynamics.vehicle import Vehicle
from offpiste.native.compilation import spread_kernel


class Given(NamedTuple):
    """Arguments of the kernels.

    Attributes:
        start: model states [B, P] (`to_kernel_state`).
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


def hidden_and_cells(recurrent: Float[Tensor, "B R"]) -> tuple[Float[Tensor, "B S"], Float[Tensor, "B S"]]:
    """Return the hidden units of all LSTMs and their cells, from the recurrent state of a model."""
    networks = recurrent.unflatten(-1, (recurrent.shape[-1] // (2 * layout.HIDDEN), 2, layout.HIDDEN))
    return networks[..., 0, :].flatten(-2), networks[..., 1, :].flatten(-2)


def to_kernel_state(model_state: ModelState) -> Float[Tensor, "B P"]:
    """Return a model state in the order of the kernels: state, actuators, all hidden units, all cells."""
    return torch.cat((model_state.state, model_state.actuators, *hidden_and_cells(model_state.recurrent)), dim=-1)


def from_kernel_state(packed: Float[Tensor, "B P"]) -> ModelState:
    """Return the model state of a row in the order of the kernels."""
    moved = ModelState.unpack(packed)
    kinds = moved.recurrent.unflatten(-1, (2, moved.recurrent.shape[-1] // (2 * layout.HIDDEN), layout.HIDDEN))
    return replace(moved, recurrent=kinds.transpose(-3, -2).flatten(-3))


def units(dynamics: Dynamics) -> int:
    """Return the number of hidden units of all LSTMs of a model."""
    return dynamics.recurrent_size // 2


def record(
    vehicle: Vehicle,
    controls: Float[Tensor, "B T U"],
    terrain: Terrain,
    terms: Float[Tensor, "B T N"],
) -> Record:
    """What the rollout is given, block by block."""
    tensors = controls, terrain.normal, terrain.known, terms
    given = tuple(tensor.detach().contiguous().numpy() for tensor in tensors)
    (batch, steps), recorded = controls.shape[:2], recorded_channels(vehicle)
    blocks = -(-batch // layout.LANES)
    rows = np.empty((blocks, steps, (GIVEN + terms.shape[2]) * layout.LANES), np.float32)
    spread_kernel(blocks, pack, *given, recorded, rows)
    return Record(rows, recorded)


def terms_of_codes(dynamics: Dynamics, codes: Float[Tensor, "B T C"]) -> Float[Tensor, "B T N"]:
    """What codes add to the gates and the hidden layer of the network that corrects the forces, differentiable.

    It does not depend on the model state, so that one matrix product before the rollout takes the place of one a step.
    Codes have no range (`Compensator.standardise_on`).
    """
    parts, _ = kernel_parts(dynamics)
    if parts.compensator is None or not codes.shape[-1]:
        return codes[..., :0]
    count = codes.shape[-1]
    mean, scale = (values[len(values) - count :] for values in (parts.compensator.mean, parts.compensator.scale))
    matrix = weights_apart(parts.compensator, count) / scale
    return functional.linear(codes, matrix, -(matrix @ mean))


def recorded_channels(vehicle: Vehicle) -> np.ndarray:
    """Which of the actuators, then of the controls, the log has."""
    return np.array(
        [*(name in vehicle.actuators for name in ACTUATORS), *(name in vehicle.control for name in layout.COMMANDS)]
    )


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


def compensator_weights(dynamics: Dynamics, *, apart: bool = False) -> Weights:
    """Weights of the network that corrects the forces, differentiable; those of the codes may stay apart."""
    parts, _ = kernel_parts(dynamics)
    return weights(parts.compensator, parts.force_scale, apart=4 * dynamics.codes if apart else 0)


def constants(dynamics: Dynamics, learned: Float[Tensor, " K"]) -> np.ndarray:
    """The vector of `layout.CONSTANTS`, from the bicycle's."""
    with torch.no_grad():
        lags = kernel_parts(dynamics)[1].flat_constants()
    return np.concatenate((learned.detach().numpy(), lags.numpy(), switches(dynamics.vehicle)), dtype=np.float32)


def switches(vehicle: Vehicle) -> list[float]:
    """What the channels of a vehicle switch on (`layout.SWITCHES`)."""
    values: dict[str, float] = {
        **{f"{name}_measured": actuator in vehicle.actuators for name, actuator in layout.MEASURED.items()},
        **{f"{one.label}_lags": one.steps(vehicle) for one in layout.LAGGING},
        "max_steer": vehicle.max_steer,
    }
    return [float(values[name]) for name in layout.SWITCHES]


def networks(dynamics: Dynamics, compensator: Weights, *, apart: bool = False) -> Networks:
    """The networks of the forces, the brake and the steering; their recurrent states follow each other in this order.

    Args:
        compensator: the first one's weights.
        apart: whether `terms_of_codes` are added instead of reading codes.
    """
    parts, actuators = kernel_parts(dynamics)
    codes = range(len(layout.ROWS), len(layout.ROWS) + 4 * dynamics.codes)
    added = len(compensator.gates) + len(compensator.inner) if apart and len(codes) else 0
    first = network(
        parts.compensator,
        compensator,
        inputs=[*compensator_inputs(dynamics.vehicle), *(() if apart else codes)],
        terms=added,
        first_hidden=0,
        first_output=layout.ROW[layout.CORRECTION[0]],
    )
    matrices = [weights(actuators.networks.get(one.label)) for one in layout.LAGGING if one.lag.residual]
    hidden = layout.HIDDEN if parts.compensator is not None else 0
    return first, *residual_networks(actuators, matrices, first_hidden=hidden)


def compensator_inputs(vehicle: Vehicle) -> list[int]:
    """Rows of the workspace that the network sees which corrects the forces; codes follow them."""
    seen = [
        *layout.STEPPED[3:6],
        *(name for name in ACTUATORS if name in vehicle.actuators),
        *(row for row, name in zip(layout.CONTROLS, layout.COMMANDS, strict=True) if name in vehicle.control),
        *layout.BODY_NORMAL,
        *layout.UNKNOWN,
        *layout.FORCE,
    ]
    return [layout.ROW[name] for name in seen]


def residual_inputs(one: Lagging) -> list[int]:
    """Rows of the workspace that an actuator's residual network sees."""
    command = layout.CONTROLS[layout.COMMANDS.index(one.actuator.follows)]
    return [layout.ROW[row] for row in (*one.columns, command, "vx")]


def residual_networks(
    actuators: Actuators, matrices: Sequence[Weights], *, first_hidden: int
) -> tuple[Network, Network]:
    """The networks of the brake and the steering.

    Args:
        matrices: their weights.
        first_hidden: hidden unit of the first one among those of all networks.
    """
    residuals, hidden = [], first_hidden
    for one, of in zip((one for one in layout.LAGGING if one.lag.residual), matrices, strict=True):
        result = actuators.networks.get(one.label)
        residuals.append(
            network(
                result,
                of,
                inputs=residual_inputs(one),
                first_hidden=hidden,
                first_output=layout.ROW[f"{one.label}_residual"],
            )
        )
        hidden += layout.HIDDEN if result is not None else 0
    brake, steer = residuals
    return brake, steer
