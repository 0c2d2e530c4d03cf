"""C code of the declared cost terms, for the compiled library and for GPUs.

Run `python -m offpiste.planning.costs.text` after a change of a term or a layer.
"""

import re
from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Final

from offpiste.core.conventions import CONTROL as CONTROLS
from offpiste.planning.costs.c_expression import CExpression, called, traced
from offpiste.planning.costs.declaration import (
    CONSTANTS,
    ELEMENTARY,
    QUANTITIES,
    CostTerm,
    arguments,
    cost_terms,
    reading_order,
)
from offpiste.planning.costs.layers import CostLayer, layer_sources
from offpiste.planning.costs.weights import places_of_numbers

PLACES: Final = {
    "vx": "state[3]", "vy": "state[4]", "yaw_rate": "state[5]", "vx_before": "v->vx_before",
    "vy_before": "v->vy_before", "cos_yaw": "v->cos_yaw", "sin_yaw": "v->sin_yaw", "world_normal_x": "normal[0]",
    "world_normal_y": "normal[1]", "world_normal_z": "normal[2]", "throttle": "v->control[0]",
    "brake": "v->control[1]", "steer": "v->control[2]", "margin_along": "v->stray[0]", "margin_across": "v->stray[1]",
}  # fmt: skip
"""C expressions of `declaration.MOTION` in `offpiste_motion_cost`."""

AS_PREDICTED: Final = {"margin_along": "0.0f", "margin_across": "0.0f"}
"""C expressions of the margins without caution."""

FUNCTIONS: Final = {name: called(f"offpiste_{name}") for name in ELEMENTARY}


def terms_text(layers: tuple[CostLayer, ...], *, cautious: bool = True) -> str:
    """Return the C code of the cost per step of all declared terms, for cost maps of these layers.

    Args:
        cautious: whether margins for position errors are given; otherwise they are 0.
    """
    terms = list(cost_terms().values())
    numbers = places_of_numbers()
    last = max(numbers, key=lambda name: numbers[name])
    of_controls = [term for term in terms if term.of_controls]
    count = numbers[last] + (len(CONTROLS) if any(last in term.numbers for term in of_controls) else 1)
    lines = [
        "/* Cost per step of the declared terms, and what they read. */",
        f"#define OFFPISTE_LAYERS {len(layers)}",
        f"#define OFFPISTE_NUMBERS {count}",
        "",
        "typedef struct {",
        "    offpiste_real control[3], cos_yaw, sin_yaw, vx_before, vy_before, layers[OFFPISTE_LAYERS];",
        *(["    offpiste_real stray[2];"] if cautious else []),
        "} offpiste_values;",
        "",
        *_control_cost(of_controls, numbers),
        *_motion_cost(
            [term for term in terms if not term.of_controls], numbers, layers, {} if cautious else AS_PREDICTED
        ),
    ]
    return "\n".join(lines) + "\n\n"


def shipped_terms_text() -> str:
    """Return the same of the terms and layers that ship, `native/cpp/costs.h`; others must not be declared."""
    return terms_text(tuple(layer for source in layer_sources() for layer in source.layers))


def _with_numbers(terms: Iterable[CostTerm], numbers: Mapping[str, int], body: list[str], shift: str = "") -> list[str]:
    """Lines, behind those that read the constants, weights and parameters that they name."""
    names = dict.fromkeys((*CONSTANTS, *(name for term in terms for name in term.numbers)))
    read = {name for name in names if re.search(rf"\b{_local(name)}\b", "\n".join(body))}
    places = {name: f"numbers[{numbers[name]}{'' if name in CONSTANTS else shift}]" for name in names if name in read}
    return [*(f"const float {_local(name)} = {place};" for name, place in places.items()), *body]


def _local(name: str) -> str:
    """Return the C name of a number, which differs from that of a quantity of the same name."""
    return name if name in CONSTANTS else f"number_{name}"


def _call(term: CostTerm, given: dict[str, object]) -> str:
    weight = {} if term.weight is None else {"weight": CExpression(_local(term.name))}
    return f"cost += {traced(term.function, given | weight, arguments(term.function))};"


def _control_cost(terms: list[CostTerm], numbers: Mapping[str, int]) -> list[str]:
    given: dict[str, object] = dict(FUNCTIONS)
    given |= {name: CExpression(_local(name)) for term in terms for name in (*CONSTANTS, *term.parameters)}
    given |= {"control": CExpression("control[k]"), "control_before": CExpression("before[k]")}
    return [
        "OFFPISTE_FN offpiste_real offpiste_control_cost(",
        "    const float* numbers, const offpiste_real* before, const offpiste_real* control) {",
        "    offpiste_real cost = {0.0f};",
        "    OFFPISTE_UNROLL",
        f"    for (int k = 0; k < {len(CONTROLS)}; k++) {{",
        *(f"        {line}" for line in _with_numbers(terms, numbers, [_call(term, given) for term in terms], " + k")),
        "    }",
        f"    return numbers[{numbers['dt']}] * cost;",
        "}",
        "",
    ]


def _motion_cost(
    terms: list[CostTerm], numbers: Mapping[str, int], layers: tuple[CostLayer, ...], fixed: dict[str, str]
) -> list[str]:
    places = PLACES | fixed | {layer.name: f"v->layers[{row}]" for row, layer in enumerate(layers)}
    parameters = {name for term in terms for name in term.parameters}
    provided = {*places, *CONSTANTS, *ELEMENTARY, *parameters, "weight"}
    given: dict[str, object] = dict(FUNCTIONS)
    given |= {name: CExpression(_local(name)) for name in (*CONSTANTS, *parameters)}
    body = []
    for name in reading_order((term.function for term in terms), provided):
        if name in places:
            given[name] = CExpression(places[name])
        elif name not in provided:
            function = QUANTITIES[name]
            body.append(f"OFFPISTE_TERM {name} = {traced(function, given, arguments(function))};")
            given[name] = CExpression(name)
    return [
        "OFFPISTE_FN offpiste_real offpiste_motion_cost(",
        "    const float* numbers, const offpiste_real* state, const offpiste_real* normal,",
        "    const offpiste_values* v) {",
        "    /* Not finite where the place is not. */",
        "    offpiste_real cost = (state[0] - state[0]) + (state[1] - state[1]);",
        *(f"    {line}" for line in _with_numbers(terms, numbers, body + [_call(term, given) for term in terms])),
        "    (void)normal;",
        f"    return numbers[{numbers['dt']}] * cost;",
        "}",
    ]


if __name__ == "__main__":
    files("offpiste.native").joinpath("cpp", "costs.h").write_text(shipped_terms_text())  # type: ignore[attr-defined]
