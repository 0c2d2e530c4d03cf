"""Numba, as all of offpiste uses it: functions that loops call, and functions that Python calls."""

import hashlib
import inspect
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numba

Function = Callable[..., Any]


def called(function: Function, **options: Any) -> Function:
    """Machine code of a function that compiled ones call."""
    # Tests wrap every function of offpiste to check its types; Numba needs what is inside.
    return numba.njit(error_model="numpy", **options)(inspect.unwrap(function))  # type: ignore[no-any-return]


def entry(function: Function, sources: Iterable[Path], **options: Any) -> Function:
    """A function that Python calls; it releases the GIL, and its machine code is kept on disk where that is possible.

    Numba looks only at the file of the function itself to see whether what it kept is still valid, hence a digest of
    the sources in its name.

    Args:
        sources: files of all that it may call.
    """
    function = inspect.unwrap(function)
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in sources)).hexdigest()
    function.__qualname__ += f"_{digest[:16]}"
    try:
        return called(function, nogil=True, cache=True, **options)
    except RuntimeError:  # no folder to keep it in
        return called(function, nogil=True, **options)
