"""Numba, as the proving ground uses it: its physics and its sensors."""

from pathlib import Path
from typing import Any

from offpiste import compiled
from offpiste.compiled import Function

_OPTIONS: dict[str, Any] = {"fastmath": {"contract", "nsz", "arcp"}}


def scalar(function: Function) -> Function:
    """A scalar function of the physics, for Python and for others of its kind (`compiled.entry`)."""
    return compiled.entry(function, _sources())


def inlined(function: Function) -> Function:
    """A scalar function that becomes part of the loop that calls it."""
    return compiled.called(function, forceinline=True, **_OPTIONS)


def ray_loop(function: Function) -> Function:
    """A loop of the sensors that Python calls (`compiled.entry`)."""
    return compiled.entry(function, _sources(), **_OPTIONS)


def _sources() -> list[Path]:
    return sorted(Path(__file__).parent.glob("*.py"))
