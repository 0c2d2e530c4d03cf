"""Numba, as the kernels use it: three kinds of compiled function.

`fastmath` allows fused multiply-add, and where a sum over lanes is wanted its reordering, but never assumes that
numbers are finite: a diverged rollout must say so. Loops neither make nor keep arrays, so they do not count references
to them (`_nrt`); nor can they, then, assign slices, which may need a copy: `matrix.copy` does.
"""

from functools import partial
from pathlib import Path

from offpiste import compiled
from offpiste.compiled import Function

_called = partial(compiled.called, fastmath={"contract"})


def inlined(function: Function) -> Function:
    """A scalar function that becomes part of the loop that calls it."""
    return _called(function, forceinline=True, _nrt=False)


def lane_loop(function: Function) -> Function:
    """A function that does the same to every lane."""
    return _called(function, _nrt=False)


def lane_sum(function: Function) -> Function:
    """A function that adds up lanes, in any order."""
    return _called(function, fastmath={"contract", "reassoc"}, _nrt=False)


def maker(function: Function) -> Function:
    """A function that makes arrays."""
    return _called(function)


def entry(function: Function, *callees: Path) -> Function:
    """A function that Python calls (`compiled.entry`).

    Args:
        callees: files, beside those of this folder, of what it may call.
    """
    return compiled.entry(function, (*_sources(), *callees), fastmath={"contract"})


def _sources() -> list[Path]:
    return sorted(Path(__file__).parent.glob("*.py"))
