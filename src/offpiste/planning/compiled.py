"""Numba, as planning uses it: loops that Python calls, kept on disk until a source of theirs changes."""

from pathlib import Path

from offpiste.compiled import Function
from offpiste.dynamics.kernels.jit import entry

SOURCES = ("fused_kernel.py", "fused_survey.py", "limits.py", "nearest.py", "terms.py")
"""What holds compiled functions."""


def planning_entry(function: Function) -> Function:
    """`entry` that may call what is compiled in this package."""
    return entry(function, *(Path(__file__).with_name(name) for name in SOURCES))
