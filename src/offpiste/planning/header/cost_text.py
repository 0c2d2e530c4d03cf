"""Generation of C for the declared cost terms and layers, and for the kernels of the planner."""

from importlib.resources import files
from typing import Final

from offpiste.core.conventions import DT
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.step_text import shipped_text, step_text
from offpiste.planning.caution import Caution
from offpiste.planning.costs.layers import CostLayer
from offpiste.planning.costs.text import terms_text
from offpiste.uncertainty.spread import EVERY, INTERVAL

INFINITE: Final = "3.4e38f * 10.0f"
"""Infinity, without a header that NVRTC lacks."""


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
    lines = [*_stray_sizes(caution), "", *_layer_functions(layers, lanes)]
    return terms_text(layers, cautious=caution is not None) + "\n".join(lines) + "\n"


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
