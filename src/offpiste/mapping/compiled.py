"""Numba, as the map uses it."""

from pathlib import Path
from typing import Any

from offpiste import compiled
from offpiste.compiled import Function

# Numbers that are not finite are looked for, so they may not be assumed away. Loops neither make nor keep arrays, so
# counting references to their parts (`_nrt`) is of no use, and took two thirds of the time of an insertion.
_OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "_nrt": False}


def inlined(function: Function) -> Function:
    """A function that becomes part of the loop that calls it."""
    return compiled.called(function, forceinline=True, **_OPTIONS)


def row_loop(function: Function) -> Function:
    """A loop over a row that other loops call; compiled once, not anew wherever it is called."""
    return compiled.called(function, **_OPTIONS)


def map_loop(function: Function) -> Function:
    """A loop that Python calls (`compiled.entry`)."""
    return compiled.entry(function, sorted(Path(__file__).parent.glob("*.py")), **_OPTIONS)
