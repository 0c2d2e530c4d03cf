"""The compiled library (`native/cpp`): loading it for this processor, and its functions on NumPy arrays."""

import ctypes
import logging
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, Final

import numpy as np

from offpiste.core.errors import OffpisteError
from offpiste.native.sources import digest

logger = logging.getLogger(__name__)

MISSING: Final = "there is no compiled library; install g++, then offpiste again"
"""Reason and remedy where there is no library."""

SETS: Final = ("avx512", "avx2", "baseline")
"""Instruction sets that the library is compiled for, the best first."""

Type = type[int] | type[float] | str | np.dtype[Any]
"""Type of an argument: a whole number (int64_t), a number (double), or the items of an array, such as "f4"."""


@cache
def library() -> ctypes.CDLL | None:
    """Return the library for this processor; None if the installation had no C++ compiler."""
    return _loaded(instruction_set())


@cache
def instruction_set() -> str:
    """Return the best set that processor and installation support: "avx512", "avx2" or "baseline"; "" for none."""
    baseline = _loaded("baseline")
    if baseline is None:
        return ""
    known = SETS[SETS.index(_text(baseline, "instruction_set")) :]
    return next(candidate for candidate in known if _loaded(candidate) is not None)


@cache
def _loaded(name: str) -> ctypes.CDLL | None:
    for path in Path(__file__).parent.glob(f"_{name}.*"):
        try:
            loaded = ctypes.CDLL(str(path))
            if _text(loaded, "sources") == digest():
                return loaded
            reason = "it was built from other sources"
        except (OSError, AttributeError) as error:
            reason = str(error)
        logger.warning(f"{path} cannot be used ({reason}); install offpiste again")
    return None


def _text(loaded: ctypes.CDLL, name: str) -> str:
    entry = getattr(loaded, f"offpiste_{name}")
    entry.restype = ctypes.c_char_p
    text: bytes = entry()
    return text.decode()


def compiled(*types: Type, returns: type[int] | type[float] | None = None) -> Callable[..., Any]:
    """Replace a function by `offpiste_<name>` of the library; without a library the function itself runs.

    The Python function is attribute `plain` of the result. Arguments are positional.

    Args:
        types: of the arguments; arrays must be contiguous, and None stands for no array.
    """

    def replace(function: Callable[..., Any]) -> Callable[..., Any]:
        run = entry(function.__name__, *types, returns=returns)

        @wraps(function)
        def chosen(*arguments: Any) -> Any:
            if library() is None:
                _tell_slow(function.__module__)
                return function(*arguments)
            return run(*arguments)

        chosen.plain = function  # type: ignore[attr-defined]
        return chosen

    return replace


def entry(name: str, *types: Type, returns: type[int] | type[float] | None = None) -> Callable[..., Any]:
    """Return the function `offpiste_<name>` of the library, which releases the GIL.

    Args:
        types: of the arguments; arrays must be contiguous, and None stands for no array.

    Raises:
        OffpisteError: there is no library, when it is called.
        TypeError: an array has another type or is not contiguous, when it is called.
    """
    # No comparison with `float`: NumPy's float64 equals it.
    items = [None if isinstance(kind, type) else np.dtype(kind) for kind in types]
    bound = cache(lambda: _bound(name, types, returns))

    def run(*arguments: Any) -> Any:
        given = zip(arguments, items, strict=True)
        return bound()(*(value if kind is None else _pointer(name, value, kind) for value, kind in given))

    return run


_C_TYPES: Final[dict[Any, Any]] = {int: ctypes.c_int64, float: ctypes.c_double, None: None}


def _bound(name: str, types: tuple[Type, ...], returns: type[int] | type[float] | None) -> Any:
    of = library()
    if of is None:
        what, _, how = MISSING.partition("; ")
        raise OffpisteError(what, how=how)
    bound = getattr(of, f"offpiste_{name}")
    bound.argtypes = [_C_TYPES[kind] if isinstance(kind, type) else ctypes.c_void_p for kind in types]
    bound.restype = _C_TYPES[returns]
    return bound


def _pointer(name: str, array: np.ndarray | None, items: np.dtype[Any]) -> int | None:
    if array is None:
        return None
    if array.dtype != items or not array.flags.c_contiguous:
        raise TypeError(f"{name} takes contiguous arrays of {items}, not {array.dtype} with strides {array.strides}")
    return array.ctypes.data


@cache
def _tell_slow(module: str) -> None:
    logger.warning(f"{module} runs without the compiled library, many times slower: {MISSING}")
