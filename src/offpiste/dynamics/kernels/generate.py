"""Prints the scalar physics, forward and adjoint: as loops over lanes for Numba, and as C.

Run `python -m offpiste.dynamics.kernels.generate` after a change of the physics or of `offpiste.core.channels`.

The physics is called with SymPy's symbols. The elementary functions that it calls are recorded, each result as a new
symbol (`tape`); what lies between them is algebra, which SymPy differentiates and shares. `dialects` print the result.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final, NamedTuple

import sympy as sp

from offpiste.dynamics.bicycle import Elementary
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.dialects import NUMBA, C, Code, Dialect, Place
from offpiste.dynamics.kernels.scalar_step import Values, actuate, advance, cell, sense
from offpiste.dynamics.kernels.tape import Definitions, Tape, share

FILE: Final = Path(__file__).with_name("generated.py")
HEADERS: Final = Path(__file__).parents[1] / "header"

NUMBA_TOP: Final = '''# ruff: noqa
# fmt: off
# mypy: ignore-errors
"""Loops over lanes, forward and adjoint. Written by `python -m offpiste.dynamics.kernels.generate`; do not edit.

w: rows of a workspace, w_bar: their adjoints, c: constants, c_bar: lanes of the learned constants' adjoints. Forward
loops overwrite the rows that they compute; adjoint loops add to the rows of w_bar (and c_bar) that forward loops read.
"""

from offpiste.dynamics.kernels.elementary import atan, cos, f4, maximum, sin, step, tanh
from offpiste.native.compilation import KERNELS
'''

C_TOP: Final = """\
/* {about} Written by `python -m offpiste.dynamics.kernels.generate`; do not edit.
   {rows} */
"""
FORWARD_ROWS: Final = "w: rows of one sample's workspace, c: constants. Rows that are computed are overwritten."
ADJOINT_ROWS: Final = "w, c: as in physics.h. w_bar, c_bar: adjoints of rows and of learned constants, added to."


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


STEP: Final = (
    Loop(sense, layout.ROW, layout.LANES, (*layout.CONTROLS, *layout.NORMAL)),
    Loop(advance, layout.ROW, layout.LANES, (*layout.CONTROLS, *layout.NORMAL)),
)
ACTUATE: Final = Loop(actuate, layout.ROW, layout.LANES, (*layout.CONTROLS, "vx"), layout.LAG_CONSTANTS)
CELL: Final = Loop(cell, layout.CELL_ROW, layout.LANES * layout.HIDDEN)


def files() -> dict[Path, str]:
    """Text of every generated file."""
    loops, parts = (*STEP, ACTUATE, CELL), (*STEP, CELL)
    numba = "".join(f"\n\n{forward(loop, NUMBA)}\n\n{adjoint(loop, NUMBA)}" for loop in loops)
    about = "One step without its networks, and one unit of an LSTM."
    return {
        FILE: NUMBA_TOP + numba,
        HEADERS / "physics.h": C_TOP.format(about=about, rows=FORWARD_ROWS)
        + "".join(f"\n{forward(loop, C)}" for loop in parts),
        HEADERS / "physics_adjoint.h": C_TOP.format(about="The same backwards.", rows=ADJOINT_ROWS)
        + "".join(f"\n{adjoint(loop, C)}" for loop in parts),
    }


def forward(loop: Loop, dialect: Dialect) -> str:
    """Code of a forward loop."""
    tape, outputs = _trace(loop)
    definitions, results = share(tape.definitions(), outputs)
    stores = [(Place("w", loop.rows[name]), term) for name, term in results.items()]
    return dialect.code(_code(loop, loop.function.__name__, definitions, stores, adds=False))


def adjoint(loop: Loop, dialect: Dialect) -> str:
    """Code of the loop's adjoint."""
    tape, outputs = _trace(loop)
    reverse, bars = tape.adjoint({sp.Symbol(f"{name}_bar"): term for name, term in outputs.items()})
    wanted = [name for name in (*loop.rows, *loop.learned) if name not in loop.recorded]
    gradients = {name: bars[sp.Symbol(name)] for name in wanted if sp.Symbol(name) in bars}
    definitions, results = share(tape.definitions() + reverse, gradients)
    stores = [
        (Place("w_bar", loop.rows[name]) if name in loop.rows else Place("c_bar", loop.learned.index(name)), term)
        for name, term in results.items()
    ]
    return dialect.code(_code(loop, f"{loop.function.__name__}_adjoint", definitions, stores, adds=True))


def _trace(loop: Loop) -> tuple[Tape, dict[str, sp.Expr]]:
    tape = Tape()
    values = {name: sp.Symbol(name) for name in (*loop.rows, *layout.CONSTANTS)}
    return tape, {name: sp.sympify(term) for name, term in loop.function(values, tape.elementary).items()}


def _code(loop: Loop, name: str, definitions: Definitions, stores: list[tuple[Place, sp.Expr]], *, adds: bool) -> Code:
    terms: Iterable[sp.Expr] = (*(term for _, term in definitions), *(term for _, term in stores))
    read = {str(symbol) for term in terms for symbol in term.free_symbols}
    constants = {name: Place("c", i) for i, name in enumerate(layout.CONSTANTS) if name in read}
    loads = {name: Place("w", row) for name, row in loop.rows.items() if name in read}
    loads |= {f"{name}_bar": Place("w_bar", row) for name, row in loop.rows.items() if f"{name}_bar" in read}
    used = {place.array for place in (*constants.values(), *loads.values(), *(place for place, _ in stores))}
    arrays = tuple(array for array in ("w", "c", "w_bar", "c_bar") if array in used)
    return Code(name, loop.lanes, arrays, constants, loads, definitions, stores, adds)


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text)
