"""How a cost term is declared: once, for the eager planner (torch) and for the fused kernel (Numba) alike.

A term is a function of plain scalars that gives a cost per second at one moment. What it reads it names as its
arguments: base quantities (`MOTION`, `CONTROL`, `CONSTANTS`), derived quantities (`quantity`), layers of the cost map
(`costs.layers`), elementary functions (`ELEMENTARY`), its `weight`, and parameters. Torch calls the function with
tensors of any shape; Numba compiles it into the kernel. Hence arithmetic only, and no float literals, which would turn
float32 lanes into float64. What is not finite makes the cost not finite, and the trajectory infinitely expensive.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

from offpiste.core.conventions import CONTROL as CONTROLS
from offpiste.core.errors import PlanningError
from offpiste.core.registry import Registry

Scalar = Any
"""A number or a tensor of any shape."""

Number = float | tuple[float, ...]
"""A weight; of a term of the controls one for each of `conventions.CONTROL`."""

Function = Callable[..., Scalar]

MOTION: Final = {
    "vx": "forward velocity after the step [m/s]",
    "vy": "velocity to the left [m/s]",
    "yaw_rate": "[rad/s]",
    "vx_before": "forward velocity before the step [m/s]",
    "vy_before": "velocity to the left before the step [m/s]",
    "cos_yaw": "cosine of the heading",
    "sin_yaw": "sine of the heading",
    "stray_along": "how far errors of position reach along the heading, as the risk counts them [m]",
    "stray_across": "the same, across the heading [m]",
    "world_normal_x": "mean of the surface normals under the wheels, world frame",
    "world_normal_y": "the same, y",
    "world_normal_z": "the same, z",
    "throttle": "as commanded during the step [0..1]",
    "brake": "as commanded during the step [0..1]",
    "steer": "as commanded during the step [-1..1, + left]",
}
"""Base quantities of the vehicle's motion."""

CONTROL: Final = {
    "control": "one of throttle, brake, steer as commanded during the step",
    "control_before": "the same, during the step before",
}
"""Base quantities of terms that are evaluated for each control and summed."""

CONSTANTS: Final = {"dt": "a step [s]", "gravity": "standard gravity [m/s^2]"}

ELEMENTARY: Final = ("maximum", "sin", "cos", "tanh", "atan")
"""Elementary functions; torch's or the kernel's are passed in."""


@dataclass(frozen=True)
class Parameter:
    """A number beside the weight that a term, or a quantity it reads, depends on."""

    default: Number
    unit: str


@dataclass(frozen=True)
class CostTerm:
    """A term of the cost of driving.

    Attributes:
        function: from the scalars that it names to a cost per second [1/s].
        weight: default and unit; None for a function without an argument `weight`.
        parameters: others, by name.
    """

    name: str
    function: Function
    weight: Parameter | None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)

    @property
    def numbers(self) -> dict[str, Parameter]:
        """Weight and parameters by the names that they have in `CostWeights`."""
        own = {} if self.weight is None else {self.name: self.weight}
        return own | dict(self.parameters)

    @property
    def of_controls(self) -> bool:
        """Whether the term is evaluated for each control."""
        return any(name in CONTROL for name in arguments(self.function))


COST_TERMS: Final[Registry[CostTerm]] = Registry("cost term", package="offpiste.planning.costs", error=PlanningError)

QUANTITIES: Final[Registry[Function]] = Registry("quantity", package="offpiste.planning.costs", error=PlanningError)
"""Derived quantities: functions of other quantities, named after what they give."""


def cost_term(
    name: str, *, unit: str, weight: Number | None = None, parameters: Mapping[str, Parameter] | None = None
) -> Callable[[Function], Function]:
    """Declare a cost term.

    Args:
        name: of the term, and of its weight in `CostWeights`.
        unit: of the weight, such that the term is a cost per second.
        weight: default; one for each of `conventions.CONTROL` for a term that reads `control`. None for a function
            without an argument `weight`.
        parameters: other numbers of `CostWeights` that the function, or a quantity that it reads, names.

    Raises:
        PlanningError: the function reads controls and motion, or its name or that of a parameter is taken.
    """

    def declare(function: Function) -> Function:
        term = CostTerm(name, function, None if weight is None else Parameter(weight, unit), dict(parameters or {}))
        check_term(term)
        COST_TERMS.register(name)(term)
        return function

    return declare


def quantity(function: Function) -> Function:
    """Declare a derived quantity, a function of other quantities that terms read by its name."""
    return QUANTITIES.register(function.__name__)(function)


def cost_terms() -> dict[str, CostTerm]:
    """All terms by name: those that ship first, of motion before those of controls; then others by name."""

    def place(entry: tuple[str, CostTerm]) -> tuple[bool, bool, str]:
        name, term = entry
        ships = term.function.__module__.startswith("offpiste.")
        return not ships, term.of_controls, "" if ships else name

    return dict(sorted(COST_TERMS.items(), key=place))


@cache
def arguments(function: Function) -> tuple[str, ...]:
    """What a function reads, by name."""
    return tuple(inspect.signature(function).parameters)


def evaluate(function: Function, given: dict[str, Scalar]) -> Scalar:
    """Call a function with what it reads; derived quantities are added to `given` when they are first read.

    Raises:
        PlanningError: nothing provides what the function reads.
    """
    for name in arguments(function):
        if name not in given:
            given[name] = evaluate(_quantity(name, function, given), given)
    return function(*(given[name] for name in arguments(function)))


def reading_order(functions: Iterable[Function], given: Iterable[str]) -> tuple[str, ...]:
    """Names that functions read, each behind those that it is derived from.

    Args:
        given: names that are not derived.

    Raises:
        PlanningError: nothing provides what a function reads.
    """
    known, ordered = set(given), dict[str, None]()

    def visit(function: Function) -> None:
        for name in arguments(function):
            if name not in ordered:
                if name not in known:
                    visit(_quantity(name, function, known))
                ordered[name] = None

    for function in functions:
        visit(function)
    return tuple(ordered)


def _quantity(name: str, reader: Function, given: Iterable[str]) -> Function:
    if name not in QUANTITIES:
        there = ", ".join(sorted({*given, *QUANTITIES} - {*ELEMENTARY}))
        raise PlanningError(
            f"'{reader.__name__}' reads '{name}', which nothing provides",
            how=f"declare it as a quantity, a cost layer or a parameter; there are: {there}",
        )
    return QUANTITIES[name]


def check_term(term: CostTerm) -> None:
    """Refuse a declaration that contradicts itself.

    Raises:
        PlanningError: see `cost_term`.
    """
    read = set(arguments(term.function))
    if (term.weight is not None) != ("weight" in read):
        raise PlanningError(
            f"cost term '{term.name}': a default weight and an argument 'weight' go together", how="give both or none"
        )
    if read & CONTROL.keys() and read - {*CONTROL, *CONSTANTS, *ELEMENTARY, *term.parameters, "weight"}:
        raise PlanningError(
            f"cost term '{term.name}' reads one control and the vehicle's motion",
            how="read throttle, brake and steer instead of control, or make it two terms",
        )
    if term.of_controls and any(
        not isinstance(number.default, tuple) or len(number.default) != len(CONTROLS)
        for number in term.numbers.values()
    ):
        raise PlanningError(
            f"cost term '{term.name}' reads 'control' and needs numbers for each", how=f"give {len(CONTROLS)} of each"
        )
    reserved = {*MOTION, *CONTROL, *CONSTANTS, *ELEMENTARY, "weight"} & term.parameters.keys()
    if reserved:
        raise PlanningError(
            f"cost term '{term.name}' has a parameter called '{min(reserved)}', which is a quantity", how="rename it"
        )
