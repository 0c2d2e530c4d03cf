"""Declaration of cost terms, for the eager planner (torch) and the fused kernel (C).

A term is a function of scalars that returns a cost per second. Its arguments name its inputs: base quantities
(`MOTION`, `CONTROL`, `CONSTANTS`), derived quantities (`quantity`), layers of the cost map (`costs.layers`), elementary
functions (`ELEMENTARY`), its `weight`, and parameters. Torch calls the function with tensors; the kernel has it
as C, traced by `c_expression`. Hence it uses arithmetic, comparisons and the elementary functions only.
Non-finite inputs must give a non-finite cost, which excludes the trajectory.
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
"""A number, or one for each of `conventions.CONTROL`."""

Function = Callable[..., Scalar]

MOTION: Final = {
    "vx": "forward velocity after the step [m/s]",
    "vy": "velocity to the left [m/s]",
    "yaw_rate": "[rad/s]",
    "vx_before": "forward velocity before the step [m/s]",
    "vy_before": "velocity to the left before the step [m/s]",
    "cos_yaw": "cosine of the heading",
    "sin_yaw": "sine of the heading",
    "margin_along": "margin for position errors along the heading, by the risk setting [m]",
    "margin_across": "margin for position errors across the heading [m]",
    "world_normal_x": "mean of the surface normals under the wheels, world frame",
    "world_normal_y": "the same, y",
    "world_normal_z": "the same, z",
    "throttle": "command during the step [0..1]",
    "brake": "command during the step [0..1]",
    "steer": "command during the step [-1..1, + left]",
}
"""Base quantities of the vehicle's motion."""

CONTROL: Final = {
    "control": "command of throttle, brake or steer during the step",
    "control_before": "command during the step before",
}
"""Base quantities of terms evaluated for each control and summed."""

CONSTANTS: Final = {"dt": "duration of a step [s]", "gravity": "standard gravity [m/s^2]"}

ELEMENTARY: Final = ("maximum", "sin", "cos", "tanh", "atan")
"""Elementary functions, passed in by torch or the kernel."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a term or of a quantity that it reads."""

    default: Number
    unit: str


@dataclass(frozen=True)
class CostTerm:
    """A term of the cost of driving.

    Attributes:
        function: function that returns a cost per second [1/s].
        weight: default and unit; None for a function without an argument `weight`.
        parameters: parameters by name.
    """

    name: str
    function: Function
    weight: Parameter | None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)

    @property
    def numbers(self) -> dict[str, Parameter]:
        """Weight and parameters by their names in `CostWeights`."""
        own = {} if self.weight is None else {self.name: self.weight}
        return own | dict(self.parameters)

    @property
    def of_controls(self) -> bool:
        """True if the term is evaluated for each control."""
        return any(name in CONTROL for name in arguments(self.function))


COST_TERMS: Final[Registry[CostTerm]] = Registry("cost term", package="offpiste.planning.costs", error=PlanningError)

QUANTITIES: Final[Registry[Function]] = Registry("quantity", package="offpiste.planning.costs", error=PlanningError)
"""Derived quantities: functions of other quantities, by name."""


def cost_term(
    name: str, *, unit: str, weight: Number | None = None, parameters: Mapping[str, Parameter] | None = None
) -> Callable[[Function], Function]:
    """Declare a cost term.

    Args:
        name: name of the term, and of its weight in `CostWeights`.
        unit: unit of the weight, such that the term is a cost per second.
        weight: default; one for each of `conventions.CONTROL` for a term that reads `control`. None for a function
            without an argument `weight`.
        parameters: further numbers of `CostWeights` read by the function or its quantities.

    Raises:
        PlanningError: the function reads both single controls and motion, or a name is taken.
    """

    def declare(function: Function) -> Function:
        term = CostTerm(name, function, None if weight is None else Parameter(weight, unit), dict(parameters or {}))
        check_term(term)
        COST_TERMS.register(name)(term)
        return function

    return declare


def quantity(function: Function) -> Function:
    """Declare a derived quantity, which terms read by its name."""
    return QUANTITIES.register(function.__name__)(function)


def cost_terms() -> dict[str, CostTerm]:
    """Return all terms by name: those of offpiste first, of motion before those of controls; then others by name."""

    def place(entry: tuple[str, CostTerm]) -> tuple[bool, bool, str]:
        name, term = entry
        ships = term.function.__module__.startswith("offpiste.")
        return not ships, term.of_controls, "" if ships else name

    return dict(sorted(COST_TERMS.items(), key=place))


@cache
def arguments(function: Function) -> tuple[str, ...]:
    """Return the names of the inputs of a function."""
    return tuple(inspect.signature(function).parameters)


def evaluate(function: Function, given: dict[str, Scalar]) -> Scalar:
    """Call a function with its inputs; derived quantities are added to `given` when first read.

    Raises:
        PlanningError: nothing provides an input.
    """
    for name in arguments(function):
        if name not in given:
            given[name] = evaluate(_quantity(name, function, given), given)
    return function(*(given[name] for name in arguments(function)))


def reading_order(functions: Iterable[Function], given: Iterable[str]) -> tuple[str, ...]:
    """Return the names of all inputs of functions, in the order of their derivation.

    Args:
        given: names that are not derived.

    Raises:
        PlanningError: nothing provides an input.
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
            how=f"declare it as a quantity, a cost layer or a parameter; available: {there}",
        )
    return QUANTITIES[name]


def check_term(term: CostTerm) -> None:
    """Raise for an inconsistent declaration.

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
