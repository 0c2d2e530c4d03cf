"""Numba and threads, as the map uses them."""

import hashlib
import inspect
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numba

Function = Callable[..., Any]

# Numbers that are not finite are looked for, so they may not be assumed away. Loops neither make nor keep arrays, so
# counting references to their parts (`_nrt`) is of no use, and took two thirds of the time of an insertion.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "_nrt": False}


def inlined(function: Function) -> Function:
    """A function that becomes part of the loop that calls it."""
    # Tests wrap every function of offpiste to check its types; Numba needs what is inside.
    return numba.njit(inspect.unwrap(function), forceinline=True, **_OPTIONS)  # type: ignore[no-any-return]


def row_loop(function: Function) -> Function:
    """A loop over a row that other loops call; compiled once, not anew wherever it is called."""
    return numba.njit(inspect.unwrap(function), **_OPTIONS)  # type: ignore[no-any-return]


def map_loop(function: Function) -> Function:
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


def spread(threads: int, blocks: int, kernel: Callable[..., None], *arguments: object) -> None:
    """Call `kernel(first, last, *arguments)` on contiguous parts of the blocks, one in each thread."""
    threads = min(threads, blocks)
    if threads <= 1:
        return kernel(0, blocks, *arguments)
    cuts = [blocks * i // threads for i in range(threads + 1)]
    first, *others = pairwise(cuts)
    futures = [_pool(threads).submit(kernel, *part, *arguments) for part in others]
    kernel(*first, *arguments)
    for future in futures:
        future.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads - 1, thread_name_prefix="offpiste-map")


if hasattr(os, "register_at_fork"):  # threads do not survive a fork
    os.register_at_fork(after_in_child=_pool.cache_clear)


@cache
def _sources() -> str:
    files = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
