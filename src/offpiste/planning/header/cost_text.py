"""Generation of C for the declared cost terms and layers, and for the kernels of the planner."""

import re
from collections.abc import Iterable
from importlib.resources import files
from typing import Final

from offpiste.core.conventions import CONTROL as CONTROLS
from offpiste.core.conventions import DT
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.step_text import shipped_text, step_text
from offpiste.planning.caution import Caution
from offpiste.planning.costs.declaration import (
    CONSTANTS,
    ELEMENTARY,
    QUANTITIES,
    CostTerm,
    arguments,
    cost_terms,
    reading_order,
)
from offpiste.planning.costs.layers import CostLayer
from offpiste.planning.header.c_expression import CExpression, called, traced
from offpiste.planning.kernel_costs import Numbers, places_of_numbers
from offpiste.uncertainty.spread import EVERY, INTERVAL

PLACES: Final = {
    "vx": "state[3]", "vy": "state[4]", "yaw_rate": "state[5]", "vx_before": "v->vx_before",
    "vy_before": "v->vy_before", "cos_yaw": "v->cos_yaw", "sin_yaw": "v->sin_yaw", "world_normal_x": "normal[0]",
    "world_normal_y": "normal[1]", "world_normal_z": "normal[2]", "throttle": "v->control[0]",
    "brake": "v->control[1]", "steer": "v->control[2]", "margin_along": "v->stray[0]", "margin_across": "v->stray[1]",
}  # fmt: skip
"""C expressions of `declaration.MOTION` in `offpiste_motion_cost`."""

AS_PREDICTED: Final = {"margin_along": "0.0f", "margin_across": "0.0f"}
"""C expressions of the margins without caution."""

INFINITE: Final = "3.4e38f * 10.0f"
"""Infinity, without a header that NVRTC lacks."""

FUNCTIONS: Final = {name: called(f"offpiste_{name}") for name in ELEMENTARY}


def plan_text(
    dynamics: Dynamics, layers: tuple[CostLayer, ...], caution: Caution | None = None, *, lanes: bool = False
) -> str:
    """Return the C++ and CUDA text of the kernels `offpiste_roll_out` and `offpiste_keep_within`.

    Args:
        caution: of the plans; its numbers are not in the text, but in the situation (`costs.packed_situation`).
        lanes: whether `LANES` threads share a sample of `offpiste_roll_out`, as they do on GPUs.

    Raises:
        ValueError: kernels cannot step the model.
        PlanningError: a term reads what nothing provides, or cannot be written as C.
    """
    here = files(__package__)
    parts = [step_text(dynamics, lanes=lanes), shipped_text("kernels.h"), shipped_text("terrain.h")]
    parts.append(cost_text(layers, caution, lanes=lanes))
    parts += [here.joinpath(name).read_text("utf-8") for name in ("stray.h", "plan.h", "limits.h")]
    return "\n".join(parts)


def cost_text(layers: tuple[CostLayer, ...], caution: Caution | None = None, *, lanes: bool = False) -> str:
    """Return the C code of all declared terms, for cost maps of these layers; for the others, see `plan_text`."""
    terms = list(cost_terms().values())
    numbers = places_of_numbers(terms)
    last = max(numbers, key=lambda name: numbers[name])
    of_controls = [term for term in terms if term.of_controls]
    count = numbers[last] + (len(CONTROLS) if any(last in term.numbers for term in of_controls) else 1)
    lines = [
        "/* Cost per step of the declared terms, and the layers of the cost map that they read. */",
        f"#define OFFPISTE_LAYERS {len(layers)}",
        f"#define OFFPISTE_NUMBERS {count}",
        *_stray_sizes(caution),
        "",
        "typedef struct {",
        "    float control[3], cos_yaw, sin_yaw, vx_before, vy_before, layers[OFFPISTE_LAYERS];",
        *(["    float stray[2];"] if caution else []),
        "} offpiste_values;",
        "",
        *_layer_functions(layers, lanes),
        *_control_cost(of_controls, numbers),
        *_motion_cost(
            [term for term in terms if not term.of_controls], numbers, layers, {} if caution else AS_PREDICTED
        ),
    ]
    return "\n".join(lines) + "\n"


def _stray_sizes(caution: Caution | None) -> list[str]:
    """Return the sizes for which `stray.h` is compiled."""
    if caution is None:
        return ["#define OFFPISTE_STRAY 0"]
    sizes = {"STRAY": caution.spread.hidden, "STRAY_EVERY": EVERY}
    times = {"STRAY_INTERVAL": INTERVAL, "STRAY_STEP": DT}
    return [
        *(f"#define OFFPISTE_{name} {value}" for name, value in sizes.items()),
        *(f"#define OFFPISTE_{name} {value!r}f" for name, value in times.items()),
    ]


def _layer_functions(layers: tuple[CostLayer, ...], lanes: bool) -> list[str]:
    begin, wheel, join, pose = [], [], [], []
    for row, layer in enumerate(layers):
        value = f"v->layers[{row}]"
        number = f"cell[{row}]" if layer.outside is None else f"(inside ? cell[{row}] : outside[{row}])"
        if layer.read == "pose point":
            pose.append(f"{value} = {number};")
        elif layer.read == "mean of wheels":
            begin.append(f"{value} = 0.0f;")
            wheel.append(f"{value} += 0.25f * {number};")
            join.append(f"{value} = offpiste_over_lanes({value});")
        else:
            begin.append(f"{value} = {INFINITE};")
            wheel += ["{", f"    const float number = {number};", f"    {value} = number < {value} ? number : {value};"]
            wheel.append("}")
            join.append(f"{value} = offpiste_least_of_lanes({value});")
    read = "(const float* cell, int inside, const float* outside, offpiste_values* v)"
    unused = "(void)cell; (void)inside; (void)outside; (void)v;"
    functions = [
        ("begin_layers(offpiste_values* v)", ["(void)v;", *begin]),
        (f"read_wheel_layers{read}", [unused, *wheel]),
        (f"read_pose_layers{read}", [unused, *pose]),
    ]
    if lanes:
        functions.append(("join_layers(offpiste_values* v)", ["(void)v;", *join]))
    lines = []
    for head, body in functions:
        lines += [f"OFFPISTE_FN void offpiste_{head} {{", *(f"    {line}" for line in body), "}", ""]
    return lines


def _with_numbers(terms: Iterable[CostTerm], numbers: Numbers, body: list[str], shift: str = "") -> list[str]:
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


def _control_cost(terms: list[CostTerm], numbers: Numbers) -> list[str]:
    given: dict[str, object] = dict(FUNCTIONS)
    given |= {name: CExpression(_local(name)) for term in terms for name in (*CONSTANTS, *term.parameters)}
    given |= {"control": CExpression("control[k]"), "control_before": CExpression("before[k]")}
    return [
        "OFFPISTE_FN float offpiste_control_cost(const float* numbers, const float* before, const float* control) {",
        "    float cost = 0.0f;",
        "    OFFPISTE_UNROLL",
        f"    for (int k = 0; k < {len(CONTROLS)}; k++) {{",
        *(f"        {line}" for line in _with_numbers(terms, numbers, [_call(term, given) for term in terms], " + k")),
        "    }",
        f"    return numbers[{numbers['dt']}] * cost;",
        "}",
        "",
    ]


def _motion_cost(
    terms: list[CostTerm], numbers: Numbers, layers: tuple[CostLayer, ...], fixed: dict[str, str]
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
            body.append(f"const float {name} = {traced(function, given, arguments(function))};")
            given[name] = CExpression(name)
    return [
        "OFFPISTE_FN float offpiste_motion_cost(",
        "    const float* numbers, const float* state, const float* normal, const offpiste_values* v) {",
        "    float cost = (state[0] - state[0]) + (state[1] - state[1]); /* not finite where the place is not */",
        *(f"    {line}" for line in _with_numbers(terms, numbers, body + [_call(term, given) for term in terms])),
        "    (void)normal;",
        f"    return numbers[{numbers['dt']}] * cost;",
        "}",
    ]
