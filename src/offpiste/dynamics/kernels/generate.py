"""Prints the scalar physics, forward and adjoint, as the C that the library and the header for GPUs share.

`setup.py` runs this file during the installation, when SymPy is the only package at hand, and again after a change of
`native.sources.PRINTED_FROM`. It must import no other package.

The physics is called with SymPy's symbols. The elementary functions that it calls are recorded, each result as a new
symbol (`tape`); what lies between them is algebra, which SymPy differentiates and shares.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final, NamedTuple

import sympy as sp

from offpiste.core.conventions import FADE, STATE
from offpiste.dynamics.bicycle import Elementary
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.scalar_step import Values, actuate, advance, cell, sense
from offpiste.dynamics.kernels.tape import Definitions, Tape, share

HEADERS: Final = Path(__file__).parents[1] / "header"
LAYOUT: Final = Path(__file__).parents[2] / "native" / "cpp" / "layout.h"

TOP: Final = """\
/* {about} Printed by dynamics/kernels/generate.py; do not edit.
   {rows} */
"""
FORWARD_ROWS: Final = "w: rows of one sample's workspace, c: constants. Rows that are computed are overwritten."
ADJOINT_ROWS: Final = "w, c: as in physics.h. w_bar, c_bar: adjoints of rows and of learned constants, added to."

Stores = list[tuple[str, sp.Expr]]
"""Places that are written, with the terms written there."""


class Part(NamedTuple):
    """A scalar function and where its arguments and results lie.

    Attributes:
        rows: quantities by row.
        recorded: arguments without an adjoint.
        learned: constants with an adjoint, in its order.
    """

    function: Callable[[Values, Elementary], Values]
    rows: Mapping[str, int]
    recorded: tuple[str, ...] = ()
    learned: tuple[str, ...] = layout.LEARNED


PARTS: Final = (
    Part(sense, layout.ROW, (*layout.CONTROLS, *layout.NORMAL)),
    Part(advance, layout.ROW, (*layout.CONTROLS, *layout.NORMAL)),
    Part(actuate, layout.ROW, (*layout.CONTROLS, "vx"), layout.LAG_CONSTANTS),
    Part(cell, layout.CELL_ROW),
)


def files() -> dict[Path, str]:
    """Return the text of every generated file."""
    about = "One step without its networks, the actuators' part of it alone, and one unit of an LSTM."
    forwards, adjoints = ("".join(f"\n{printed(part)}" for part in PARTS) for printed in (forward, adjoint))
    return {
        HEADERS / "physics.h": TOP.format(about=about, rows=FORWARD_ROWS) + forwards,
        HEADERS / "physics_adjoint.h": TOP.format(about="The same backwards.", rows=ADJOINT_ROWS) + adjoints,
        LAYOUT: layout_text(),
    }


def layout_text() -> str:
    """Return rows and sizes as the library reads them (`native/cpp`)."""
    row = layout.ROW
    sizes = {
        "STATES": len(STATE), "MOVED": len(layout.STEPPED), "HIDDEN": layout.HIDDEN, "ROWS": len(layout.ROWS),
        "NEXT": row[layout.NEXT[0]], "SPEED": row["vx"], "NORMAL": row[layout.NORMAL[0]],
        "UNKNOWN": row[layout.UNKNOWN[0]], "FIRST_CONTROL": row[layout.CONTROLS[0]],
        "KNOWN_CONTROLS": len(layout.CONTROLS), "LEARNED": len(layout.LEARNED),
        "LAG_CONSTANTS": len(layout.LAG_CONSTANTS), "FADE": f"{FADE}f",
    }  # fmt: skip
    top = TOP.format(about="Rows of the workspace and sizes.", rows="See dynamics/kernels/layout.py.")
    return top + "".join(f"#define OFFPISTE_{name} {value}\n" for name, value in sizes.items())


def forward(part: Part) -> str:
    """Return the code of a part."""
    tape, outputs = _trace(part)
    definitions, results = share(tape.definitions(), outputs)
    stores = [(f"w[{part.rows[name]}]", term) for name, term in results.items()]
    return _code(part, part.function.__name__, definitions, stores, "=")


def adjoint(part: Part) -> str:
    """Return the code of a part's adjoint."""
    tape, outputs = _trace(part)
    reverse, bars = tape.adjoint({sp.Symbol(f"{name}_bar"): term for name, term in outputs.items()})
    wanted = [name for name in (*part.rows, *part.learned) if name not in part.recorded]
    gradients = {name: bars[sp.Symbol(name)] for name in wanted if sp.Symbol(name) in bars}
    definitions, results = share(tape.definitions() + reverse, gradients)
    stores = [
        (f"w_bar[{part.rows[name]}]" if name in part.rows else f"c_bar[{part.learned.index(name)}]", term)
        for name, term in results.items()
    ]
    return _code(part, f"{part.function.__name__}_adjoint", definitions, stores, "+=")


def _trace(part: Part) -> tuple[Tape, dict[str, sp.Expr]]:
    tape = Tape()
    values = {name: sp.Symbol(name) for name in (*part.rows, *layout.CONSTANTS)}
    return tape, {name: sp.sympify(term) for name, term in part.function(values, tape.elementary).items()}


def _code(part: Part, name: str, definitions: Definitions, stores: Stores, store: str) -> str:
    terms: Iterable[sp.Expr] = (*(term for _, term in definitions), *(term for _, term in stores))
    read = {str(symbol) for term in terms for symbol in term.free_symbols}
    loads = [("scalar", known, f"c[{i}]") for i, known in enumerate(layout.CONSTANTS) if known in read]
    loads += [("real", known, f"w[{row}]") for known, row in part.rows.items() if known in read]
    loads += [("real", f"{known}_bar", f"w_bar[{row}]") for known, row in part.rows.items() if f"{known}_bar" in read]
    written = {place.partition("[")[0] for place, _ in stores}
    used = written | {place.partition("[")[0] for _, _, place in loads}
    arguments = (
        f"{'' if array in written else 'const '}offpiste_{'scalar' if array == 'c' else 'real'}* {array}"
        for array in ("w", "c", "w_bar", "c_bar")
        if array in used
    )
    lines = [f"OFFPISTE_FN void offpiste_{name}({', '.join(arguments)}) {{"]
    lines += [f"const offpiste_{kind} {known} = {place};" for kind, known, place in loads]
    lines += [f"OFFPISTE_TERM {symbol} = {term_text(term)};" for symbol, term in definitions]
    lines += [f"{place} {store} {term_text(term)};" for place, term in stores]
    return "\n    ".join(lines) + "\n}\n"


def term_text(term: sp.Expr) -> str:
    """Return a term as C writes it, with numbers in single precision whatever the type of a sample."""
    if term.is_Symbol:
        return str(term)
    if term.is_Number:
        value = float(term)
        return f"({value!r}f)" if value < 0 else f"{value!r}f"
    if term.is_Add:
        return "(" + " + ".join(map(term_text, term.args)).replace(" + -", " - ") + ")"
    if term.is_Mul:
        return "-" * (term.args[0] == -1) + "*".join(term_text(factor) for factor in term.args if factor != -1)
    if term.is_Pow:
        base, exponent = term.args
        if not exponent.is_Integer:
            raise NotImplementedError(f"power {term}")
        product = "*".join([term_text(base)] * abs(int(exponent)))
        return f"({product})" if exponent > 0 else f"(1.0f/({product}))"
    function = str(term.func)
    return f"offpiste_{'above' if function == 'step' else function}({', '.join(map(term_text, term.args))})"


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text)
