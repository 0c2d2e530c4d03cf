"""Writes `generated.py`: the scalar physics as loops over lanes, forward and adjoint (reverse mode on SymPy terms).

Run `python -m offpiste.dynamics.kernels.generate` after a change of the physics or of `offpiste.channels`.

The physics is called with SymPy's symbols. The elementary functions that it calls are recorded, each result as a new
symbol; what lies between them is algebra, which SymPy differentiates and shares. What the eager model does around the
physics on batches (turning the normal, choosing measured inputs, forward Euler) is written as scalars below; tests
compare both.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import sympy as sp

from offpiste.conventions import DT, STATE
from offpiste.dynamics.bicycle import Constants, Elementary, Force, Scalar, forces, rates
from offpiste.dynamics.inputs import REDUCED, DriveTrain
from offpiste.dynamics.kernels import layout

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
    """Common subexpressions of all right-hand sides as definitions of their own; what no result needs is left out."""
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


def text(term: sp.Expr) -> str:
    """A term in Python, in float32 whatever the types of its numbers."""
    if term.is_Symbol:
        return str(term)
    if term.is_Number:
        return f"f4({float(term)!r})"
    if term.is_Add:
        return "(" + " + ".join(map(text, term.args)).replace(" + -", " - ") + ")"
    if term.is_Mul:
        return "-" * (term.args[0] == -1) + "*".join(text(factor) for factor in term.args if factor != -1)
    if term.is_Pow:
        base, exponent = term.args
        if not exponent.is_Integer:
            raise NotImplementedError(f"power {term}")
        product = "*".join([text(base)] * abs(int(exponent)))
        return f"({product})" if exponent > 0 else f"(f4(1)/({product}))"
    return f"{term.func}({', '.join(map(text, term.args))})"


Values = dict[str, Scalar]
"""Quantities by their names in `layout`."""

FILE: Final = Path(__file__).with_name("generated.py")

HEADER: Final = '''# ruff: noqa
# fmt: off
# mypy: ignore-errors
"""Loops over lanes, forward and adjoint. Written by `python -m offpiste.dynamics.kernels.generate`; do not edit.

w: rows of a workspace, w_bar: their adjoints, c: constants, c_bar: lanes of the learned constants' adjoints. Forward
loops overwrite the rows that they compute; adjoint loops add to the rows of w_bar (and c_bar) that forward loops read.
"""

from offpiste.dynamics.kernels.elementary import atan, cos, f4, maximum, sin, step, tanh
from offpiste.compilation import KERNELS
'''


def drive_train(v: Values, f: Elementary) -> DriveTrain:
    """`inputs.drive_train` with switches; slots of absent actuators are 0."""

    def pick(switch: str, measured: Scalar, reduced: Scalar) -> Scalar:
        return v[switch] * measured + (1 - v[switch]) * reduced

    def command(name: str) -> Scalar:
        return v[layout.CONTROLS[layout.COMMANDS.index(name)]]

    found = []
    for name, reduced_form in zip(DriveTrain._fields, REDUCED, strict=True):
        reduced = reduced_form(command, v["vx"], v["max_steer"], f)
        actuator = layout.MEASURED.get(name)
        found.append(reduced if actuator is None else pick(f"{name}_measured", v[actuator], reduced))
    return DriveTrain(*found)


def body_normal(v: Values, f: Elementary) -> tuple[Scalar, Scalar, Scalar]:
    """`inputs.body_normal` of the mean normal."""
    x, y, z = (v[name] for name in layout.NORMAL)
    cos, sin = f.cos(v["yaw"]), f.sin(v["yaw"])
    return cos * x + sin * y, cos * y - sin * x, z


def sense(v: Values, f: Elementary) -> Values:
    """The normal in the body frame and the parametric forces: what the networks see besides what is recorded."""
    train, normal = drive_train(v, f), body_normal(v, f)
    constants = Constants(*(v[name] for name in Constants._fields))
    read = train.brake, train.steer, train.engine, train.throttle, train.gear
    force = forces(v["vx"], v["vy"], v["yaw_rate"], *read, normal[2], constants, f)
    return dict(zip(layout.BODY_NORMAL + layout.FORCE, (*normal, *force), strict=True))


def advance(v: Values, f: Elementary) -> Values:
    """Corrected forces to rates, actuators' lags, forward Euler."""
    normal = body_normal(v, f)
    constants = Constants(*(v[name] for name in Constants._fields))
    force = Force(*(v[name] + v[more] for name, more in zip(layout.FORCE, layout.CORRECTION, strict=True)))
    steer = drive_train(v, f).steer
    motion = rates(v["yaw"], v["vx"], v["vy"], v["yaw_rate"], steer, normal[0], normal[1], force, constants, f)
    return _forward_euler(v, dict(zip(STATE, motion, strict=True)) | _lag_rates(v, f))


def actuate(v: Values, f: Elementary) -> Values:
    """Actuators' lags alone, along a recorded speed, and forward Euler."""
    return _forward_euler(v, _lag_rates(v, f))


def _lag_rates(v: Values, f: Elementary) -> Values:
    change: Values = {}
    for one in layout.LAGGING:
        command = v[layout.CONTROLS[layout.COMMANDS.index(one.actuator.follows)]]
        own = {name: v[f"{one.label}_{name}"] for name in one.lag.constants}
        changes = list(one.lag.change(tuple(v[name] for name in one.columns), command, v["vx"], own, f))
        if one.lag.residual:
            changes[-1] += v[f"{one.label}_residual"]
        change |= {name: v[f"{one.label}_lags"] * rate for name, rate in zip(one.columns, changes, strict=True)}
    return change


def _forward_euler(v: Values, change: Values) -> Values:
    stepped = zip(layout.NEXT, layout.STEPPED, strict=True)
    return {after: v[name] + DT * change[name] for after, name in stepped if name in change}


def cell(v: Values, f: Elementary) -> Values:
    """One unit of an LSTM from its gates, in the order of `torch.nn.LSTMCell`."""

    def sigmoid(x: Scalar) -> Scalar:
        return (1 + f.tanh(x / 2)) / 2

    memory = sigmoid(v["forget_gate"]) * v["memory"] + sigmoid(v["input_gate"]) * f.tanh(v["cell_gate"])
    return {"next_hidden": sigmoid(v["output_gate"]) * f.tanh(memory), "next_memory": memory}


class Loop(NamedTuple):
    """A scalar function and where its arguments and results lie.

    Attributes:
        function: its name is the loop's.
        rows: quantities by row.
        lanes: length of a row.
        recorded: arguments without an adjoint.
        learned: constants with an adjoint, in its order.
    """

    function: Callable[[Values, Elementary], Values]
    rows: Mapping[str, int]
    lanes: int
    recorded: tuple[str, ...] = ()
    learned: tuple[str, ...] = layout.LEARNED


LOOPS: Final = (
    Loop(sense, layout.ROW, layout.LANES, (*layout.CONTROLS, *layout.NORMAL)),
    Loop(advance, layout.ROW, layout.LANES, (*layout.CONTROLS, *layout.NORMAL)),
    Loop(actuate, layout.ROW, layout.LANES, (*layout.CONTROLS, "vx"), layout.LAG_CONSTANTS),
    Loop(cell, layout.CELL_ROW, layout.LANES * layout.HIDDEN),
)


def generate() -> str:
    """The text of `generated.py`."""
    return HEADER + "".join(f"\n\n{forward(loop)}\n\n{adjoint(loop)}" for loop in LOOPS)


def forward(loop: Loop) -> str:
    """Code of a forward loop."""
    tape, outputs = _trace(loop)
    definitions, results = share(tape.definitions(), outputs)
    stores = [f"w[{loop.rows[name] * loop.lanes} + i] = {text(term)}" for name, term in results.items()]
    return _code(loop, loop.function.__name__, definitions, results.values(), stores)


def adjoint(loop: Loop) -> str:
    """Code of the loop's adjoint."""
    tape, outputs = _trace(loop)
    reverse, bars = tape.adjoint({sp.Symbol(f"{name}_bar"): term for name, term in outputs.items()})
    wanted = [name for name in (*loop.rows, *loop.learned) if name not in loop.recorded]
    gradients = {name: bars[sp.Symbol(name)] for name in wanted if sp.Symbol(name) in bars}
    definitions, results = share(tape.definitions() + reverse, gradients)
    stores = []
    for name, term in results.items():
        array, row = ("w_bar", loop.rows[name]) if name in loop.rows else ("c_bar", loop.learned.index(name))
        stores.append(f"{array}[{row * loop.lanes} + i] += {text(term)}")
    return _code(loop, f"{loop.function.__name__}_adjoint", definitions, results.values(), stores)


def _trace(loop: Loop) -> tuple[Tape, dict[str, sp.Expr]]:
    tape = Tape()
    values = {name: sp.Symbol(name) for name in (*loop.rows, *layout.CONSTANTS)}
    return tape, {name: sp.sympify(term) for name, term in loop.function(values, tape.elementary).items()}


def _code(loop: Loop, name: str, definitions: Definitions, results: Iterable[sp.Expr], stores: list[str]) -> str:
    read = {str(symbol) for term in (*(term for _, term in definitions), *results) for symbol in term.free_symbols}
    constants = [f"{name} = c[{i}]" for i, name in enumerate(layout.CONSTANTS) if name in read]
    loads = [f"{name} = w[{row * loop.lanes} + i]" for name, row in loop.rows.items() if name in read]
    loads += [f"{name}_bar = w_bar[{row * loop.lanes} + i]" for name, row in loop.rows.items() if f"{name}_bar" in read]
    body = loads + [f"{symbol} = {text(term)}" for symbol, term in definitions] + stores
    arrays = [array for array in ("w", "c", "w_bar", "c_bar") if any(f" {array}[" in f" {x}" for x in constants + body)]
    lines = [f"@KERNELS.loop\ndef {name}({', '.join(arrays)}):"]
    lines += [f"    {line}" for line in constants]
    lines += [f"    for i in range({loop.lanes}):"]
    lines += [f"        {line}" for line in body]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    FILE.write_text(generate())
