"""The languages that a scalar function is printed in: loops over lanes for Numba, and C, one sample at a time."""

from collections.abc import Callable
from typing import Final, NamedTuple

import sympy as sp

from offpiste.dynamics.kernels.tape import Definitions


class Place(NamedTuple):
    """Where a quantity lies: row of an array."""

    array: str
    row: int


class Code(NamedTuple):
    """A scalar function, ready to be printed.

    Attributes:
        lanes: length of a row, in languages that loop over lanes.
        arrays: its arguments.
        constants, loads: names of what is read once, and of what is read for each sample.
        definitions: what is computed in between.
        stores: what is written.
        adds: whether stores add to what is there.
    """

    name: str
    lanes: int
    arrays: tuple[str, ...]
    constants: dict[str, Place]
    loads: dict[str, Place]
    definitions: Definitions
    stores: list[tuple[Place, sp.Expr]]
    adds: bool


class Dialect(NamedTuple):
    """A language.

    Attributes:
        number: a literal, in float32 whatever the type of the number.
        function: name of an elementary function.
        code: text of a whole function.
    """

    number: Callable[[float | int], str]
    function: Callable[[str], str]
    code: Callable[[Code], str]


def term_text(term: sp.Expr, dialect: Dialect) -> str:
    """A term as the language writes it."""

    def text(term: sp.Expr) -> str:
        if term.is_Symbol:
            return str(term)
        if term.is_Number:
            return dialect.number(float(term))
        if term.is_Add:
            return "(" + " + ".join(map(text, term.args)).replace(" + -", " - ") + ")"
        if term.is_Mul:
            return "-" * (term.args[0] == -1) + "*".join(text(factor) for factor in term.args if factor != -1)
        if term.is_Pow:
            base, exponent = term.args
            if not exponent.is_Integer:
                raise NotImplementedError(f"power {term}")
            product = "*".join([text(base)] * abs(int(exponent)))
            return f"({product})" if exponent > 0 else f"({dialect.number(1)}/({product}))"
        return f"{dialect.function(str(term.func))}({', '.join(map(text, term.args))})"

    return text(term)


def _numba(code: Code) -> str:
    def at(place: Place) -> str:
        return f"{place.array}[{place.row * code.lanes} + i]"

    lines = [f"@KERNELS.loop\ndef {code.name}({', '.join(code.arrays)}):"]
    lines += [f"    {name} = {place.array}[{place.row}]" for name, place in code.constants.items()]
    lines += [f"    for i in range({code.lanes}):"]
    lines += [f"        {name} = {at(place)}" for name, place in code.loads.items()]
    lines += [f"        {symbol} = {term_text(term, NUMBA)}" for symbol, term in code.definitions]
    store = "+=" if code.adds else "="
    lines += [f"        {at(place)} {store} {term_text(term, NUMBA)}" for place, term in code.stores]
    return "\n".join(lines) + "\n"


def _c(code: Code) -> str:
    written = {place.array for place, _ in code.stores}

    def argument(array: str) -> str:
        kind = "offpiste_scalar" if array == "c" else "offpiste_real"
        return f"{'' if array in written else 'const '}{kind}* {array}"

    lines = [f"OFFPISTE_FN void offpiste_{code.name}({', '.join(map(argument, code.arrays))}) {{"]
    lines += [f"const offpiste_scalar {name} = {place.array}[{place.row}];" for name, place in code.constants.items()]
    lines += [f"const offpiste_real {name} = {place.array}[{place.row}];" for name, place in code.loads.items()]
    lines += [f"OFFPISTE_TERM {symbol} = {term_text(term, C)};" for symbol, term in code.definitions]
    store = "+=" if code.adds else "="
    lines += [f"{place.array}[{place.row}] {store} {term_text(term, C)};" for place, term in code.stores]
    return "\n    ".join(lines) + "\n}\n"


def _c_number(value: float | int) -> str:
    return f"({value!r}f)" if value < 0 else f"{float(value)!r}f"


NUMBA: Final = Dialect(lambda value: f"f4({value!r})", str, _numba)
C: Final = Dialect(_c_number, lambda name: f"offpiste_{'above' if name == 'step' else name}", _c)
