"""Networks of a model as compiled code reads them: inputs, outputs, and weights in order."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.functional import pad

from offpiste.core.conventions import ACTUATORS
from offpiste.dynamics.actuator_lags import Lagging
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.base import Dynamics, KernelParts
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.lstm import LSTM, Compensator
from offpiste.dynamics.vehicle import Vehicle


class Weights(NamedTuple):
    """Three matrices, input by input; the numbers of outputs are multiples of four.

    Attributes:
        gates: of the LSTM cell, on (hidden before, inputs, 1).
        inner: of the hidden layer, on (inputs, 1, hidden after).
        outer: of the output layer, on (hidden layer, 1).
    """

    gates: Float[Tensor, "M G"]
    inner: Float[Tensor, "M N"]
    outer: Float[Tensor, "K O"]


class ModelNetwork(NamedTuple):
    """A network of a model.

    Attributes:
        name: "force", or the label of the actuator that it corrects.
        compensator: the module.
        weights: its matrices, differentiable.
        inputs: rows of the workspace that it sees; those behind `layout.ROWS` are codes of the wheels.
        outputs: how many, into rows from `first_output` on.
        terms: whether the contribution of codes is given (`terms_of_codes`) instead of computed from inputs.
    """

    name: str
    compensator: Compensator
    weights: Weights
    inputs: tuple[int, ...]
    first_output: int
    outputs: int
    terms: bool = False

    @property
    def width(self) -> int:
        """Units of the hidden layer, as many as are computed."""
        return self.weights.inner.shape[1]

    def ranges(self) -> dict[str, Float[Tensor, " I"]]:
        """Return standardisation and range of the inputs, by the names that compiled code has for them."""
        of, seen = self.compensator, len(self.inputs)
        values = {"mean": of.mean, "inverse_scale": 1 / of.scale, "low": of.low, "high": of.high}
        return {name: value[:seen] for name, value in values.items()}


def weights(compensator: Compensator, scale: Tensor | None = None, *, apart: int = 0) -> Weights:
    """Return the weights of a network, differentiable.

    Args:
        scale: factors of the outputs.
        apart: number of inputs, the last ones, that `weights_apart` has instead.
    """
    cell = compensator.cell
    assert isinstance(cell, LSTM)
    first, last = linear_layers(compensator.output)
    seen = cell.input_size - apart
    from_hidden, from_inputs, _ = first.weight.split((layout.HIDDEN, seen, apart), dim=1)
    bias = (cell.bias_ih + cell.bias_hh)[None]
    inner = widened(torch.cat((from_inputs.t(), first.bias[None], from_hidden.t())))
    outer = torch.cat((pad(last.weight.t(), (0, 0, 0, -last.in_features % 4)), last.bias[None]))
    return Weights(
        torch.cat((cell.weight_hh.t(), cell.weight_ih[:, :seen].t(), bias)),
        inner,
        widened(outer if scale is None else outer * scale),
    )


def weights_apart(compensator: Compensator, apart: int) -> Float[Tensor, "I N"]:
    """Return the weights of the last `apart` inputs on gates, then hidden layer, differentiable."""
    first, _ = linear_layers(compensator.output)
    assert isinstance(compensator.cell, LSTM)
    return torch.cat((compensator.cell.weight_ih[:, -apart:].t(), widened(first.weight[:, -apart:].t())), dim=1)


def linear_layers(module: nn.Module) -> list[nn.Linear]:
    """Return the linear layers among the children of a module, in order."""
    return [layer for layer in module.children() if isinstance(layer, nn.Linear)]


def with_bias(layer: nn.Linear) -> Float[Tensor, "I O"]:
    """Return the weights of a layer input by input, and its bias as the last row, differentiable."""
    return torch.cat((layer.weight.t(), layer.bias[None]))


def widened(matrix: Float[Tensor, "I O"]) -> Float[Tensor, "I N"]:
    """Return a matrix with columns of zeros up to a multiple of four."""
    return pad(matrix, (0, -matrix.shape[1] % 4))


def kernel_parts(dynamics: Dynamics) -> tuple[KernelParts, Actuators]:
    """Return the parts of a model that compiled code steps.

    Raises:
        ValueError: compiled code cannot step the model.
    """
    parts = dynamics.kernel_parts()
    if parts is None or dynamics.actuators is None:
        raise ValueError("no kernels for this model; see `supports`")
    return parts, dynamics.actuators


def model_networks(dynamics: Dynamics, *, apart: bool = False) -> tuple[ModelNetwork, ...]:
    """Return the networks of a model in the order of their recurrent states.

    Args:
        apart: whether `terms_of_codes` are added instead of reading codes.

    Raises:
        ValueError: compiled code cannot step the model.
    """
    parts, actuators = kernel_parts(dynamics)
    if parts.compensator is None:
        return residual_networks(actuators)
    codes = range(len(layout.ROWS), len(layout.ROWS) + 4 * dynamics.codes)
    inputs = (*compensator_inputs(dynamics.vehicle), *(() if apart else codes))
    of = weights(parts.compensator, parts.force_scale, apart=len(codes) if apart else 0)
    row, terms = layout.ROW[layout.CORRECTION[0]], apart and len(codes) > 0
    force = ModelNetwork("force", parts.compensator, of, inputs, row, len(layout.CORRECTION), terms)
    return force, *residual_networks(actuators)


def residual_networks(actuators: Actuators) -> tuple[ModelNetwork, ...]:
    """Return the networks that correct the lags of actuators, in the order of their recurrent states."""
    return tuple(
        ModelNetwork(one.label, network, weights(network), residual_inputs(one), layout.ROW[f"{one.label}_residual"], 1)
        for one in layout.LAGGING
        if (network := actuators.networks.get(one.label)) is not None
    )


def compensator_inputs(vehicle: Vehicle) -> tuple[int, ...]:
    """Return the rows of the workspace that the force-correcting network reads; codes follow them."""
    seen = [
        *layout.STEPPED[3:6],
        *(name for name in ACTUATORS if name in vehicle.actuators),
        *(row for row, name in zip(layout.CONTROLS, layout.COMMANDS, strict=True) if name in vehicle.control),
        *layout.BODY_NORMAL,
        *layout.UNKNOWN,
        *layout.FORCE,
    ]
    return tuple(layout.ROW[name] for name in seen)


def residual_inputs(one: Lagging) -> tuple[int, ...]:
    """Return the rows of the workspace that an actuator's residual network reads."""
    command = layout.CONTROLS[layout.COMMANDS.index(one.actuator.follows)]
    return tuple(layout.ROW[row] for row in (*one.columns, command, "vx"))


def terms_of_codes(dynamics: Dynamics, codes: Float[Tensor, "B T C"]) -> Float[Tensor, "B T N"]:
    """Return what codes add to gates and hidden layer of the network that corrects the forces, differentiable.

    It does not depend on the model state, so that one matrix product before the rollout takes the place of one a step.
    Codes have no range (`Compensator.standardise_on`).
    """
    parts, _ = kernel_parts(dynamics)
    count = codes.shape[-1]
    if parts.compensator is None or not count:
        return codes[..., :0]
    mean, scale = (values[-count:] for values in (parts.compensator.mean, parts.compensator.scale))
    matrix = weights_apart(parts.compensator, count) / scale[:, None]
    return functional.linear(codes, matrix.t(), -(matrix.t() @ mean))


def learned_constants(dynamics: Dynamics) -> Float[Tensor, " K"]:
    """Return the bicycle's constants, differentiable (`layout.LEARNED`)."""
    return torch.stack(kernel_parts(dynamics)[0].bicycle())


def constants(learned: Float[Tensor, " K"], lags: Float[Tensor, " L"], vehicle: Vehicle) -> Float[Tensor, " N"]:
    """Return the vector of `layout.CONSTANTS`."""
    return torch.cat((learned, lags.to(learned), learned.new_tensor(switches(vehicle))))


def switches(vehicle: Vehicle) -> list[float]:
    """Return the switches that the channels of a vehicle set (`layout.SWITCHES`)."""
    values: dict[str, float] = {
        **{f"{name}_measured": actuator in vehicle.actuators for name, actuator in layout.MEASURED.items()},
        **{f"{one.label}_lags": one.steps(vehicle) for one in layout.LAGGING},
        "max_steer": vehicle.max_steer,
    }
    return [float(values[name]) for name in layout.SWITCHES]


def units(dynamics: Dynamics) -> int:
    """Return the number of hidden units of all LSTMs of a model."""
    return dynamics.recurrent_size // 2


def absent_actuators(vehicle: Vehicle) -> list[int]:
    """Return the indices in `layout.STEPPED` of actuators that the log lacks."""
    return [layout.STEPPED.index(name) for name in ACTUATORS if name not in vehicle.actuators]
