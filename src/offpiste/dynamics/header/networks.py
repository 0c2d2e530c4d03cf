"""Networks of a model for the header of GPUs and exports: sizes in its text, weights in the order of its structs."""

import re
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from offpiste.core.conventions import FADE
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.networks import (
    ModelNetwork,
    constants,
    kernel_parts,
    learned_constants,
    model_networks,
)

LANE = 4
"""Numbers in 16 bytes: rows of matrices are multiples of it."""


def network_members(of: ModelNetwork) -> dict[str, Tensor]:
    """Return the tensors of a network's C struct, keyed by member name in declaration order."""
    padded = {name: pad(values, (0, -len(values) % LANE)) for name, values in of.ranges().items()}
    return padded | of.weights._asdict()


def network_text(of: ModelNetwork, template: str) -> str:
    """Return the C code of a template that was written for any network (`network.h`)."""
    sizes = {
        "INPUTS": len(of.inputs), "INPUT_PLACES": len(of.inputs) + -len(of.inputs) % LANE,
        "HIDDEN": layout.HIDDEN, "WIDTH": of.width, "OUTPUTS": of.outputs,
        "OUTPUT_PLACES": of.weights.outer.shape[1], "TERMS": int(of.terms), "FADE": f"{FADE}f",
    }  # fmt: skip
    return sized(template, sizes).replace("NAME", of.name)


def sized(template: str, sizes: Mapping[str, object]) -> str:
    """Return the C code of a template whose sizes are words in capitals."""
    return re.sub(r"\b[A-Z_]+\b", lambda word: str(sizes.get(word[0], word[0])), template)


def packed_parameters(dynamics: Dynamics, *, apart: bool = False) -> Float[Tensor, " C"]:
    """Return the numbers of `offpiste_params` in order.

    Args:
        apart: see `step_text`.
    """
    with torch.no_grad():
        parts = [parameter_constants(dynamics)]
        for network in model_networks(dynamics, apart=apart):
            parts += [values.flatten() for values in network_members(network).values()]
        return torch.cat(parts)


def parameter_constants(dynamics: Dynamics) -> Float[Tensor, " C"]:
    """Return the vector of `layout.CONSTANTS`, padded to 16 bytes."""
    lags = kernel_parts(dynamics)[1].flat_constants()
    values = constants(learned_constants(dynamics), lags, dynamics.vehicle)
    return pad(values, (0, -len(values) % LANE))
