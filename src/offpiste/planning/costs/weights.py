"""Weights and parameters of the cost terms by name."""

from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT, GRAVITY
from offpiste.core.errors import PlanningError
from offpiste.planning.costs.declaration import CONSTANTS, Number, Parameter, cost_terms


@dataclass(frozen=True, init=False, repr=False, eq=False)
class CostWeights:
    """Weights and parameters of the cost terms: `CostWeights(path=5.0, lateral_limit=0.6).path`.

    Omitted numbers keep their defaults.

    Raises:
        PlanningError: unknown name, or another shape.
    """

    changed: dict[str, Number]

    def __init__(self, **changed: Number) -> None:
        declared = declared_numbers()
        for name, value in changed.items():
            if name not in declared:
                there = ", ".join(f"{known} [{number.unit}]" for known, number in declared.items())
                raise PlanningError(f"no cost weight '{name}'", how=f"available: {there}")
            if _size(value) != _size(declared[name].default):
                raise PlanningError(
                    f"invalid cost weight {name} = {value}", how=f"give one like {declared[name].default}"
                )
        object.__setattr__(self, "changed", changed)

    def __getattr__(self, name: str) -> Any:
        """Return a weight or parameter."""
        if name.startswith("__") or name == "changed":  # copies and pickles ask before there is anything
            raise AttributeError(name)
        values = self.values()
        if name not in values:
            raise AttributeError(f"no cost weight '{name}'; available: {', '.join(values)}")
        return values[name]

    def __eq__(self, other: object) -> bool:
        """Compare all numbers, including defaults."""
        return isinstance(other, CostWeights) and self.values() == other.values()

    def __repr__(self) -> str:
        """Show the changed numbers."""
        return f"CostWeights({', '.join(f'{name}={value}' for name, value in self.changed.items())})"

    def values(self) -> dict[str, Number]:
        """Return all numbers by name."""
        return {name: number.default for name, number in declared_numbers().items()} | self.changed

    def vector(self) -> Float[Tensor, " N"]:
        """Return constants, weights and parameters as compiled code reads them (`places_of_numbers`)."""
        return torch.tensor([DT, GRAVITY, *(x for value in self.values().values() for x in _each(value))])


def places_of_numbers() -> dict[str, int]:
    """Return the places of constants, weights and parameters in the vector of numbers, by name."""
    sizes = dict.fromkeys(CONSTANTS, 1) | {name: len(_each(one.default)) for name, one in declared_numbers().items()}
    return dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))


def declared_numbers() -> dict[str, Parameter]:
    """Return weights and parameters of all cost terms by name.

    Raises:
        PlanningError: two terms declare the same name.
    """
    numbers: dict[str, Parameter] = {}
    for term in cost_terms().values():
        for name, number in term.numbers.items():
            if name in numbers:
                raise PlanningError(f"two cost terms declare a number '{name}'", how="rename yours")
            numbers[name] = number
    return numbers


def _size(value: Number) -> int:
    return len(value) if isinstance(value, tuple) else 0


def _each(value: Number) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)
