"""The networks of a model as the header has them: what each reads and writes, its sizes, and its weights in order."""

import re
from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.model_arrays import (
    compensator_inputs,
    compensator_weights,
    kernel_parts,
    learned_constants,
    residual_inputs,
    switches,
)
from offpiste.dynamics.kernels.network import Weights, weights
from offpiste.dynamics.lstm import FADE, Compensator

LANE = 4
"""Numbers in 16 bytes: rows of matrices are multiples of it."""


class PrintedNetwork(NamedTuple):
    """A network of a model.

    Attributes:
        name: "force", or the label of the actuator that it corrects.
        compensator: the module.
        weights: its matrices, differentiable.
        inputs: rows of the workspace that it sees; those behind `layout.ROWS` are codes of the wheels.
        outputs: how many, into rows from `first_output` on.
        terms: whether what codes add comes from elsewhere (`terms_of_codes`) instead of from inputs.
    """

    name: str
    compensator: Compensator
    weights: Weights
    inputs: tuple[int, ...]
    first_output: int
    outputs: int
    terms: bool

    @property
    def width(self) -> int:
        """Units of the hidden layer, as many as are computed."""
        return len(self.weights.inner)

    @property
    def members(self) -> dict[str, Tensor]:
        """Numbers of its struct by name, in order."""
        seen, hidden = len(self.inputs), layout.HIDDEN
        of, (gates, inner, outer) = self.compensator, self.weights
        ranges = {"mean": of.mean, "inverse_scale": 1 / of.scale, "low": of.low, "high": of.high}
        padded = {name: pad(values[:seen], (0, -seen % LANE)) for name, values in ranges.items()}
        return padded | {
            "gates": gates.t()[: hidden + seen + 1],
            "inner": torch.cat((inner.t()[: seen + 1], inner.t()[-hidden:])),
            "outer": outer.t()[: self.width + 1],
        }

    def text(self, template: str) -> str:
        """C code of a template that was written for any network (`network.h`)."""
        sizes = {
            "INPUTS": len(self.inputs), "INPUT_PLACES": len(self.inputs) + -len(self.inputs) % LANE,
            "HIDDEN": layout.HIDDEN, "WIDTH": self.width, "OUTPUTS": self.outputs,
            "OUTPUT_PLACES": len(self.weights.outer), "TERMS": int(self.terms), "FADE": f"{FADE}f",
        }  # fmt: skip
        return sized(template, sizes).replace("NAME", self.name)


def sized(template: str, sizes: Mapping[str, object]) -> str:
    """C code of a template whose sizes are words in capitals."""
    return re.sub(r"\b[A-Z_]+\b", lambda word: str(sizes.get(word[0], word[0])), template)


def printed_networks(dynamics: Dynamics, *, apart: bool = False) -> tuple[PrintedNetwork, ...]:
    """Return the networks of a model in the order of their recurrent states.

    Args:
        apart: whether `terms_of_codes` are added instead of reading codes.

    Raises:
        ValueError: kernels cannot step the model.
    """
    parts, actuators = kernel_parts(dynamics)
    result = []
    if parts.compensator is not None:
        codes = range(len(layout.ROWS), len(layout.ROWS) + 4 * dynamics.codes)
        inputs = (*compensator_inputs(dynamics.vehicle), *(() if apart else codes))
        of, row = compensator_weights(dynamics, apart=apart), layout.ROW[layout.CORRECTION[0]]
        terms = apart and len(codes) > 0
        result.append(PrintedNetwork("force", parts.compensator, of, inputs, row, len(layout.CORRECTION), terms))
    for one in layout.LAGGING:
        if one.label in actuators.networks:
            network, row = actuators.networks[one.label], layout.ROW[f"{one.label}_residual"]
            inputs = tuple(residual_inputs(one))
            result.append(PrintedNetwork(one.label, network, weights(network), inputs, row, 1, False))
    return tuple(result)


def packed_parameters(dynamics: Dynamics, *, apart: bool = False) -> Float[Tensor, " P"]:
    """The numbers of `offpiste_params` in order, on the model's device."""
    with torch.no_grad():
        parts = [parameter_constants(dynamics)]
        for network in printed_networks(dynamics, apart=apart):
            parts += [values.flatten() for values in network.members.values()]
        return torch.cat(parts)


def parameter_constants(dynamics: Dynamics) -> Float[Tensor, " C"]:
    """The vector of `layout.CONSTANTS`, padded to 16 bytes."""
    learned = learned_constants(dynamics)
    lags = kernel_parts(dynamics)[1].flat_constants()
    values = torch.cat((learned, lags.to(learned), learned.new_tensor(switches(dynamics.vehicle))))
    return pad(values, (0, -len(values) % LANE))
