"""Numbers of a model as initialisers of C structs."""

import numpy as np
from torch import Tensor

from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.networks import parameter_constants, printed_networks
from offpiste.dynamics.header.start_text import encoder_members, start_members

WIDTH = 118
"""Longest line."""


def weights_text(dynamics: Dynamics) -> str:
    """C definitions of `offpiste_model`, `offpiste_starts` and, of models with an encoder, `offpiste_features`."""
    networks = {of.name: of.members for of in printed_networks(dynamics)}
    starts = start_members(dynamics)
    parts = [
        _struct("offpiste_params", "offpiste_model", {"constants": parameter_constants(dynamics), **networks}),
        _struct("offpiste_start_params", "offpiste_starts", starts),
    ]
    if dynamics.encoder is not None:
        parts.append(_struct("offpiste_encoder", "offpiste_features", encoder_members(dynamics.encoder)))
    return "\n".join(parts)


def _struct(kind: str, name: str, members: object) -> str:
    # C++ compilers warn of a static constant that a program does not use; C's attribute is theirs, too.
    return f"OFFPISTE_CONSTANT {kind} {name} = {_initialiser(members) if members else '{0.0f}'};\n"


def _initialiser(value: object) -> str:
    if isinstance(value, dict):
        parts = [f"/* {name} */\n{_initialiser(inner)}" for name, inner in value.items()]
        return "{\n" + ",\n".join(parts) + "\n}"
    assert isinstance(value, Tensor)
    numbers = value.detach().float().cpu().numpy()
    if numbers.ndim == 1:
        return _wrapped([_number(number) for number in numbers])
    return "{\n" + ",\n".join(_wrapped([_number(number) for number in row]) for row in numbers) + "\n}"


def _number(value: np.float32) -> str:
    text = f"{value:.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


def _wrapped(numbers: list[str]) -> str:
    lines, line = [], "{"
    for place, number in enumerate(numbers):
        part = number + ("," if place < len(numbers) - 1 else "}")
        if len(line) + len(part) + 1 > WIDTH:
            lines.append(line)
            line = part
        else:
            line = f"{line} {part}" if line != "{" else f"{{{part}"
    return "\n".join((*lines, line))
