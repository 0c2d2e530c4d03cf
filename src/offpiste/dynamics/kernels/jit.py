"""Numba, as the kernels use it: three kinds of compiled function.

`fastmath` allows fused multiply-add, and where a sum over lanes is wanted its reordering, but never assumes that
numbers are finite: a diverged rollout must say so. Loops neither make nor keep arrays, so they do not count references
to them (`_nrt`); nor can they, then, assign slices, which may need a copy: `matrix.copy` does.
"""

import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

Function = Callable[..., Any]


def inlined(function: Function) -> Function:
    """A scalar function that becomes part of the loop that calls it."""
    return _compile(function, forceinline=True, _nrt=False)


def lane_loop(function: Function) -> Function:
    """A function that does the same to every lane."""
    return _compile(function, _nrt=False)


def lane_sum(function: Function) -> Function:
    """A function that adds up lanes, in any order."""
    return _compile(function, fastmath={"contract", "reassoc"}, _nrt=False)


def maker(function: Function) -> Function:
    """A function that makes arrays."""
    return _compile(function)


def entry(function: Function) -> Function:
    """A function that Python calls; it releases the GIL, and its machine code is kept on disk where that is possible.

    Numba looks only at the file of the function itself to see whether what it kept is still valid, hence a digest of
    the sources of all kernels in the name.
    """
    function = inspect.unwrap(function)
    function.__qualname__ += f"_{_sources()}"
    try:
        return _compile(function, nogil=True, cache=True)
    except RuntimeError:  # no folder to keep it in
        return _compile(function, nogil=True)


def _compile(function: Function, **options: Any) -> Function:
    options = {"fastmath": {"contract"}, "error_model": "numpy", **options}
    # Tests wrap every function of offpiste to check its types; Numba needs what is inside.
    return numba.njit(**options)(inspect.unwrap(function))  # type: ignore[no-any-return]


def _sources() -> str:
    files = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
