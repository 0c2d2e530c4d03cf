"""Elementary functions as they are called with SymPy's symbols, and reverse mode on what lies between the calls."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import sympy as sp

from offpiste.dynamics.bicycle import Elementary

Definitions = list[tuple[sp.Symbol, sp.Expr]]
"""Assignments in an order in which they can be carried out."""


class Tape:
    """Records calls of elementary functions."""

    def __init__(self) -> None:
        self.calls: dict[tuple[str, tuple[sp.Expr, ...]], sp.Symbol] = {}
        self.elementary = Elementary(*(partial(self._call, name) for name in Elementary._fields))

    def _call(self, name: str, *arguments: object) -> sp.Symbol:
        key = name, tuple(sp.sympify(argument) for argument in arguments)
        return self.calls.setdefault(key, sp.Symbol(f"{name}_{len(self.calls)}"))

    def definitions(self) -> Definitions:
        """Every recorded call, as an assignment."""
        return [(symbol, sp.Function(name)(*arguments)) for (name, arguments), symbol in self.calls.items()]

    def adjoint(self, outputs: Mapping[sp.Symbol, sp.Expr]) -> tuple[Definitions, dict[sp.Symbol, sp.Expr]]:
        """The reverse pass.

        Args:
            outputs: expressions by the symbols of their adjoints.

        Returns:
            Adjoints of the recorded calls, last call first, and those of all other symbols.
        """
        bars: dict[sp.Symbol, sp.Expr] = {}

        def spread(bar: sp.Expr, expression: sp.Expr) -> None:
            for symbol in sorted(expression.free_symbols, key=str):
                bars[symbol] = bars.get(symbol, sp.Integer(0)) + bar * sp.diff(expression, symbol)

        for bar, expression in outputs.items():
            spread(bar, expression)
        reverse = []
        for (name, arguments), symbol in reversed(list(self.calls.items())):
            bar = sp.Symbol(f"{symbol}_bar")
            reverse.append((bar, bars.pop(symbol, sp.Integer(0))))
            for argument, slope in zip(arguments, self._slopes(name, arguments, symbol), strict=True):
                spread(bar * slope, argument)
        return reverse, bars

    def _slopes(self, name: str, arguments: Sequence[sp.Expr], result: sp.Symbol) -> Iterable[sp.Expr]:
        """Partial derivatives of an elementary function by its arguments."""
        if name == "maximum":
            a, b = arguments
            return self._call("step", a, b), self._call("step", b, a)
        (x,) = arguments
        return (
            {
                "sin": lambda: self._call("cos", x),
                "cos": lambda: -self._call("sin", x),
                "tanh": lambda: 1 - result**2,
                "atan": lambda: 1 / (1 + x**2),
            }[name](),
        )


def share(definitions: Definitions, results: Mapping[str, sp.Expr]) -> tuple[Definitions, dict[str, sp.Expr]]:
    """Define common subexpressions once, and drop definitions that no result needs."""
    symbols = [symbol for symbol, _ in definitions]
    terms = [*(term for _, term in definitions), *results.values()]
    common, reduced = sp.cse(terms, symbols=sp.numbered_symbols("t"))
    meaning = dict(common) | dict(zip(symbols, reduced[: len(symbols)], strict=True))
    last = dict(zip(results, reduced[len(symbols) :], strict=True))

    ordered: dict[sp.Symbol, sp.Expr] = {}

    def define(term: sp.Expr) -> None:
        for symbol in sorted(term.free_symbols, key=str):
            if symbol in meaning and symbol not in ordered:
                define(meaning[symbol])
                ordered[symbol] = meaning[symbol]

    for term in last.values():
        define(term)
    return list(ordered.items()), last
