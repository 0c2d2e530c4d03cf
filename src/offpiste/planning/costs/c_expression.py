"""Tracing of Python functions of scalars into C expressions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from offpiste.core.errors import PlanningError


@dataclass(frozen=True, eq=False)
class CExpression:
    """A C expression as text; arithmetic on it returns further expressions."""

    text: str

    def __add__(self, other: Any) -> "CExpression":
        return _binary(self, "+", other)

    def __radd__(self, other: Any) -> "CExpression":
        return _binary(other, "+", self)

    def __sub__(self, other: Any) -> "CExpression":
        return _binary(self, "-", other)

    def __rsub__(self, other: Any) -> "CExpression":
        return _binary(other, "-", self)

    def __mul__(self, other: Any) -> "CExpression":
        return _binary(self, "*", other)

    def __rmul__(self, other: Any) -> "CExpression":
        return _binary(other, "*", self)

    def __truediv__(self, other: Any) -> "CExpression":
        return _binary(self, "/", other)

    def __rtruediv__(self, other: Any) -> "CExpression":
        return _binary(other, "/", self)

    def __neg__(self) -> "CExpression":
        return CExpression(f"(-{self.text})")

    def __abs__(self) -> "CExpression":
        return CExpression(f"offpiste_maximum({self.text}, (-{self.text}))")

    def __pow__(self, exponent: Any) -> "CExpression":
        if not isinstance(exponent, int) or exponent < 1:
            raise TypeError(f"power {exponent}")
        return CExpression(f"({' * '.join([self.text] * exponent)})")

    def __gt__(self, other: Any) -> "CExpression":
        return _comparison(self, ">", other)

    def __lt__(self, other: Any) -> "CExpression":
        return _comparison(self, "<", other)

    def __ge__(self, other: Any) -> "CExpression":
        return _comparison(self, ">=", other)

    def __le__(self, other: Any) -> "CExpression":
        return _comparison(self, "<=", other)

    def __bool__(self) -> bool:
        raise TypeError("a branch on a number")


def traced(function: Callable[..., Any], given: Mapping[str, Any], arguments: tuple[str, ...]) -> str:
    """Return the C text of the result of a function, called with some of the given arguments.

    Raises:
        PlanningError: it does more than arithmetic.
    """
    try:
        return _text(function(*(given[name] for name in arguments)))
    except (TypeError, AttributeError) as error:
        what = f"'{function.__name__}' cannot be written as C: {error}"
        raise PlanningError(what, how="use arithmetic, comparisons and the elementary functions alone") from error


def called(name: str) -> Callable[..., CExpression]:
    """Return an elementary function of C."""
    return lambda *arguments: CExpression(f"{name}({', '.join(map(_text, arguments))})")


def _text(value: Any) -> str:
    if isinstance(value, CExpression):
        return value.text
    if isinstance(value, int | float):
        return f"({float(value)!r}f)" if value < 0 else f"{float(value)!r}f"
    raise TypeError(f"{type(value).__name__} instead of a number")


def _binary(a: Any, operator: str, b: Any) -> CExpression:
    return CExpression(f"({_text(a)} {operator} {_text(b)})")


def _comparison(a: Any, operator: str, b: Any) -> CExpression:
    return CExpression(f"({_text(a)} {operator} {_text(b)} ? 1.0f : 0.0f)")
