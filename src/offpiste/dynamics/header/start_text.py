"""C code of networks that run once and not at each step: recurrent states at the start, codes of terrain features."""

from collections.abc import Sequence

import torch
from torch import Tensor

from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.feature_encoder import Compressor, FeatureEncoder
from offpiste.dynamics.header.networks import network_text, sized
from offpiste.dynamics.header.step_text import MOVED, inputs_text, shipped_text
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.coverage import uncovered_encoder
from offpiste.dynamics.kernels.networks import ModelNetwork, linear_layers, model_networks, units, with_bias


def start_text(dynamics: Dynamics) -> str:
    """C code of `offpiste_start`, behind `step_text`."""
    networks = model_networks(dynamics)
    parts = []
    for of in networks:
        first, _ = linear_layers(of.compensator.init_output)
        sizes = {"SPAN": of.compensator.init_cell.hidden_size, "BREADTH": first.out_features}
        parts.append(network_text(of, sized(shipped_text("start.h"), sizes)))
    return "\n".join((*parts, _start(dynamics, networks)))


def start_members(dynamics: Dynamics) -> dict[str, dict[str, Tensor]]:
    """Numbers of `offpiste_start_params` by network and name, in order."""
    return {of.name: _members(of) for of in model_networks(dynamics)}


def encoder_text(encoder: FeatureEncoder) -> str:
    """C code of `offpiste_encode`.

    Raises:
        ValueError: the encoder is not covered (`coverage.uncovered_encoder`).
    """
    if reason := uncovered_encoder(encoder):
        raise ValueError(f"no C code of this encoder: {reason}")
    sizes = {"FEATURES": len(encoder.mean), "COMPRESSED": int(isinstance(encoder, Compressor))}
    if isinstance(encoder, Compressor):
        first, second, last = linear_layers(encoder.layers)
        sizes |= {"FIRST": first.out_features, "SECOND": second.out_features, "CODE": last.out_features}
    return sized(shipped_text("encoder.h"), sizes)


def encoder_members(encoder: FeatureEncoder) -> dict[str, Tensor]:
    """Numbers of `offpiste_encoder` by name, in order."""
    if not isinstance(encoder, Compressor):
        return {"mean": encoder.mean}
    names = zip(("first", "second", "last"), map(with_bias, linear_layers(encoder.layers)), strict=True)
    return {"mean": encoder.mean, "inverse_scale": 1 / encoder.scale, **dict(names)}


def _members(of: ModelNetwork) -> dict[str, Tensor]:
    weights, (first, last) = of.compensator.init_cell.state_dict(), linear_layers(of.compensator.init_output)
    bias = (weights["bias_ih_l0"] + weights["bias_hh_l0"])[None]
    return {
        "from_inputs": torch.cat((weights["weight_ih_l0"].t(), bias)),
        "from_hidden": weights["weight_hh_l0"].t(),
        "first": with_bias(first),
        "last": with_bias(last),
    }


def _start(dynamics: Dynamics, networks: Sequence[ModelNetwork]) -> str:
    count = units(dynamics)
    remember, begin = [], []
    for number, of in enumerate(networks):
        hidden = MOVED + layout.HIDDEN * number
        remember += [
            inputs_text(of),
            f"offpiste_{of.name}_remember(&params->{of.name}, &starts->{of.name}, {of.name}_inputs, &{of.name});",
        ]
        places = f"state + {hidden}, state + {hidden + count}"
        begin.append(f"offpiste_{of.name}_begin(&starts->{of.name}, &{of.name}, {places});")
    members = [f"    offpiste_{of.name}_start_network {of.name};" for of in networks]
    return "\n".join(
        (
            "typedef struct {",
            *(members or ["    float nothing;"]),
            "} offpiste_start_params;",
            "",
            "/* The networks' part of a state, behind its first 10 numbers, from past rows, oldest first: states and",
            "   actuators before the start, [count, 10], and what was given at each. */",
            "OFFPISTE_FN void offpiste_start(",
            "    const offpiste_params* params, const offpiste_start_params* starts, const offpiste_real* rows,",
            "    const offpiste_given* given_at, int count, offpiste_real* state) {",
            *(f"    offpiste_{of.name}_past {of.name} = {{{{0.0f}}, {{0.0f}}}};" for of in networks),
            "    for (int row = 0; row < count; row++) {",
            "        const offpiste_given* given = given_at + row;",
            "        offpiste_real w[OFFPISTE_ROWS];",
            f"        offpiste_see(params, given, rows + {MOVED} * row, w);",
            *(f"        {line}" for line in remember),
            "    }",
            *(f"    {line}" for line in begin),
            "    (void)starts;",
            "    (void)state;",
            "}",
            "",
        )
    )
