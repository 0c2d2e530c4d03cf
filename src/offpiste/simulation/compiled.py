"""Numba, as the sensors use it."""

import hashlib
import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

Function = Callable[..., Any]

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}}


def inlined(function: Function) -> Function:
    """A scalar function that becomes part of the loop that calls it."""
    # Tests wrap every function of offpiste to check its types; Numba needs what is inside.
    return numba.njit(inspect.unwrap(function), forceinline=True, **_OPTIONS)  # type: ignore[no-any-return]


def ray_loop(function: Function) -> Function:
    """A loop that Python calls; it releases the GIL, and its machine code is kept on disk where that is possible.

    Numba looks only at the file of the loop itself to see whether what it kept is still valid, hence a digest of the
    sources of everything that it may call in its name.
    """
    function = inspect.unwrap(function)
    function.__qualname__ += f"_{_sources()}"
    try:
        return numba.njit(function, nogil=True, cache=True, **_OPTIONS)  # type: ignore[no-any-return]
    except RuntimeError:  # no folder to keep it in
        return numba.njit(function, nogil=True, **_OPTIONS)  # type: ignore[no-any-return]


@cache
def _sources() -> str:
    files = (Path(__file__).with_name(f"{name}.py") for name in ("compiled", "texture", "shading"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
