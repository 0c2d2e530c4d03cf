"""The declared cost terms and layers as kernel code: loops over lanes, written from the tables.

`kernel_rollout.roll_out` and `kernel_terrain.sample_terrain` call `LOOPS`. They are written here for each set of terms
and layers, and the rollout is compiled with them; its machine code is kept on disk under a digest of their sources.
"""

import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, Final

import numpy as np

from offpiste.core.conventions import CONTROL as CONTROLS
from offpiste.core.conventions import DT, GRAVITY
from offpiste.dynamics.kernels import elementary
from offpiste.dynamics.kernels.elementary import Lane, f4
from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.rollout import NORMAL_ROW
from offpiste.dynamics.kernels.vectors import read_fours
from offpiste.native.compilation import PLANNING
from offpiste.planning.costs.declaration import (
    CONSTANTS,
    ELEMENTARY,
    QUANTITIES,
    CostTerm,
    Function,
    arguments,
    cost_terms,
    reading_order,
)
from offpiste.planning.costs.layers import CostLayer, Reading
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.kernel_rollout import roll_out
from offpiste.planning.kernel_terrain import (
    ACROSS,
    ALONG,
    COS,
    FIRST_LAYER,
    POSE_POINT,
    SIN,
    find_border_numbers,
    find_numbers,
    sample_terrain,
)

ROWS: Final = {
    "vx": ("after", 3), "vy": ("after", 4), "yaw_rate": ("after", 5), "vx_before": ("before", 3),
    "vy_before": ("before", 4), "cos_yaw": ("values", COS), "sin_yaw": ("values", SIN),
    "margin_along": ("values", ALONG), "margin_across": ("values", ACROSS),
    "world_normal_x": ("w", NORMAL_ROW), "world_normal_y": ("w", NORMAL_ROW + 1),
    "world_normal_z": ("w", NORMAL_ROW + 2), "throttle": ("command", 0), "brake": ("command", 1),
    "steer": ("command", 2),
}  # fmt: skip
"""Array and row of each of `declaration.MOTION` in `roll_out`."""

LOOPS: Final = ("control_cost", "read_layers", "motion_cost")
"""Functions that the rollout calls."""

Layers = tuple[tuple[str, Reading, bool], ...]
"""Name and place of each layer, and whether the nearest cell counts off the map."""

Numbers = dict[str, int]
"""Where constants, weights and parameters lie in the vector of numbers, by name."""


@dataclass(frozen=True)
class KernelCosts:
    """A set of cost terms as the kernel takes it.

    Attributes:
        roll_out: compiled with the terms.
        names: of their weights and parameters, in the order of the vector of numbers.
    """

    roll_out: Callable[..., None]
    names: tuple[str, ...]

    def numbers(self, weights: CostWeights) -> np.ndarray:
        """Constants, weights and parameters as the loops read them (float32)."""
        return vector_of_numbers(weights, self.names)


def kernel_costs(layers: tuple[CostLayer, ...]) -> KernelCosts:
    """The rollout with all declared terms, for cost maps of these layers.

    Raises:
        PlanningError: a term reads what nothing provides.
    """
    return _kernel_costs(
        tuple(cost_terms()), tuple((layer.name, layer.read, layer.outside is None) for layer in layers)
    )


@cache
def _kernel_costs(names: tuple[str, ...], layers: Layers) -> KernelCosts:
    terms = [cost_terms()[name] for name in names]
    numbers = places_of_numbers(terms)
    of_controls, of_motion = ([t for t in terms if t.of_controls is kind] for kind in (True, False))
    names_of_layers = tuple(name for name, _, _ in layers)
    loops = (
        _control_cost(of_controls, numbers),
        _read_layers(layers),
        _motion_cost(of_motion, numbers, names_of_layers),
    )
    functions = {_term(term): term.function for term in terms}
    functions |= {_derived(name): function for name, function in QUANTITIES.items()}
    compiled = {name: _function(text, name, functions) for name, text in zip(LOOPS, loops, strict=True)}
    compiled["sample_terrain"] = PLANNING.loop(_calling(sample_terrain, compiled))
    entry = _calling(roll_out, compiled)
    salt = "\n".join((*loops, *_sources(functions.values())))
    return KernelCosts(PLANNING.entry(entry, salt=salt), tuple(numbers)[len(CONSTANTS) :])


def places_of_numbers(terms: Iterable[CostTerm]) -> Numbers:
    """Where constants, weights and parameters of terms lie in the vector of numbers."""
    defaults = {name: number.default for term in terms for name, number in term.numbers.items()}
    sizes = dict.fromkeys(CONSTANTS, 1) | {name: np.size(value) for name, value in defaults.items()}
    ends = np.cumsum(list(sizes.values()))
    return {name: int(end) - size for (name, size), end in zip(sizes.items(), ends, strict=True)}


def vector_of_numbers(weights: CostWeights, names: Iterable[str]) -> np.ndarray:
    """Constants, then weights and parameters by name, as kernels read them (float32)."""
    values = weights.values()
    return np.concatenate(([DT, GRAVITY], *(np.ravel(values[name]) for name in names)), dtype=np.float32)


def _calling(function: Function, compiled: dict[str, Function]) -> Function:
    """A copy of a function that calls what was compiled instead of the placeholders of its module."""
    function = inspect.unwrap(function)
    return FunctionType(function.__code__, function.__globals__ | compiled, function.__name__)


def _control_cost(terms: list[CostTerm], numbers: Numbers) -> str:
    """Code of the loop over controls."""
    return "\n".join(
        (
            "def control_cost(_numbers, _command_before, _command, _total):",
            *(f"    {name} = _numbers[{numbers[name]}]" for name in CONSTANTS),
            f"    for _k in range({len(CONTROLS)}):",
            *(f"        {local} = _numbers[{numbers[name]} + _k]" for name, local in _numbers(terms)),
            f"        for _i in range(_k * {LANES}, (_k + 1) * {LANES}):",
            "            control, control_before = _command[_i], _command_before[_i]",
            *(f"            {line}" for line in _sum(terms)),
            f"            _total[_i - _k * {LANES}] += dt * _cost",
        )
    )


def _read_layers(layers: Layers) -> str:
    """Code that reads the layers under a wheel, or at the pose point, four neighbours at a time."""
    first, wheel, pose = [], [], []
    for row, (_, read, border) in enumerate(layers):
        values = f"_values[{(FIRST_LAYER + row) * LANES} + _i]"
        if read == "pose point":
            pose.append((row, border, f"{values} = _number"))
        elif read == "mean of wheels":
            first.append(f"{values} = f4(0)")
            wheel.append((row, border, f"{values} += f4(0.25) * _number"))
        else:
            first.append(f"{values} = f4(inf)")
            wheel.append((row, border, f"{values} = least(_number, {values})"))
    return "\n".join(
        (
            "def read_layers(_k, _cost_cells, _cells, _index, _read, _values):",
            "    if _k == 0:",
            f"        for _i in range({LANES}):",
            *(f"            {line}" for line in first or ["pass"]),
            f"    if _k < {POSE_POINT}:",
            *(f"        {line}" for line in _reading(wheel, len(layers)) or ["pass"]),
            "    else:",
            *(f"        {line}" for line in _reading(pose, len(layers)) or ["pass"]),
        )
    )


def _reading(uses: list[tuple[int, bool, str]], layers: int) -> list[str]:
    """Lines that read layers, and what is done with each: its row, whether the nearest cell counts off the map, how."""
    lines: list[str] = []
    start, found = 0, None
    for row, border, use in uses:
        if found != border or row >= start + 4:
            start, found = min(row, max(layers - 4, 0)), border
            lines.append(f"find_{'border_' if border else ''}numbers(_cells, {max(layers, 4)}, _index)")
            lines.append(f"read_fours(_cost_cells.layers, _index, {start}, _cost_cells.outside, _read)")
        lines += [f"for _i in range({LANES}):", f"    _number = _read[{(row - start) * LANES} + _i]", f"    {use}"]
    return lines


@PLANNING.inlined
def least(a: Lane, b: Lane) -> Lane:
    """Smaller of two numbers."""
    return a if a < b else b


def _motion_cost(terms: list[CostTerm], numbers: Numbers, layers: tuple[str, ...]) -> str:
    """Code of the loop over states."""
    rows = ROWS | {name: ("values", FIRST_LAYER + row) for row, name in enumerate(layers)}
    parameters = {name for term in terms for name in term.parameters}
    given = {*rows, *CONSTANTS, *ELEMENTARY, *parameters, "weight"}
    read = reading_order((term.function for term in terms), given)
    lines = []
    for name in read:
        if name in rows:
            array, row = rows[name]
            lines.append(f"{name} = _{array}[{row * LANES} + _i]")
        elif name not in given:
            lines.append(f"{name} = {_call(_derived(name), QUANTITIES[name])}")
    return "\n".join(
        (
            "def motion_cost(_numbers, _w, _before, _after, _command, _values, _total):",
            *(f"    {name} = _numbers[{numbers[name]}]" for name in CONSTANTS),
            *(f"    {local} = _numbers[{numbers[name]}]" for name, local in _numbers(terms)),
            f"    for _i in range({LANES}):",
            *(f"        {line}" for line in (*lines, *_sum(terms))),
            # A place that is not finite has no cost that is.
            f"        _cost += (_after[_i] - _after[_i]) + (_after[{LANES} + _i] - _after[{LANES} + _i])",
            "        _total[_i] += dt * _cost",
        )
    )


def _numbers(terms: list[CostTerm]) -> list[tuple[str, str]]:
    """Names of weights and parameters, and what the code calls them."""
    weights = [(term.name, _weight(term)) for term in terms if term.weight is not None]
    return weights + [(name, name) for term in terms for name in term.parameters]


def _sum(terms: list[CostTerm]) -> list[str]:
    """Lines that add the terms up."""
    calls = (_call(_term(term), term.function, _weight(term)) for term in terms)
    return [f"_cost {'+=' if number else '='} {call}" for number, call in enumerate(calls)]


def _call(name: str, function: Function, weight: str = "") -> str:
    given = (weight if argument == "weight" else argument for argument in arguments(function))
    return f"{name}({', '.join(given)})"


def _term(term: CostTerm) -> str:
    return f"{term.name}_term"


def _weight(term: CostTerm) -> str:
    return f"{term.name}_weight"


def _derived(name: str) -> str:
    return f"{name}_of"


def _function(text: str, name: str, functions: dict[str, Function]) -> Callable[..., None]:
    """A loop, compiled from its code and inlined: see `kernel_terrain`."""
    names: dict[str, Any] = {name: getattr(elementary, name) for name in ELEMENTARY}
    names |= {
        "f4": f4,
        "inf": np.inf,
        "least": least,
        "read_fours": read_fours,
        "find_numbers": find_numbers,
        "find_border_numbers": find_border_numbers,
    }
    names |= {known: PLANNING.inlined(function) for known, function in functions.items() if f"{known}(" in text}
    exec(text, names)
    return PLANNING.inlined(names[name])


def _sources(functions: Iterable[Function]) -> list[str]:
    """Text that changes when a function that does not ship changes, or what it reads: numbers, functions, modules."""
    texts: dict[object, str] = {}
    waiting = [*map(inspect.unwrap, functions)]
    while waiting:
        function = waiting.pop()
        if function in texts or function.__module__.startswith("offpiste."):
            continue
        code, read = function.__code__, inspect.getclosurevars(function)
        own = (function.__name__, code.co_code, code.co_consts, code.co_names, function.__defaults__)
        texts[function] = " ".join(map(repr, own))
        for name, value in sorted((*read.globals.items(), *read.nonlocals.items())):
            called = getattr(value, "py_func", value)
            if inspect.isfunction(called):
                waiting.append(called)
            elif inspect.ismodule(value):
                file = Path(getattr(value, "__file__", ""))
                texts[value] = file.read_text("utf-8") if file.suffix == ".py" else name
            else:
                texts[function] += f" {name} = {value!r}"
    return list(texts.values())
