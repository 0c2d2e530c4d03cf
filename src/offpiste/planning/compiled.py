"""Numba, as planning uses it: loops that Python calls, kept on disk until a source of theirs changes."""

import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from offpiste.dynamics.kernels.jit import entry

SOURCES = ("fused_kernel.py", "fused_survey.py", "limits.py", "nearest.py", "terms.py")
"""What holds compiled functions; Numba itself looks at the file of the called one only."""


def planning_entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """`entry`, with a digest of this package's compiled sources in its name."""
    function = inspect.unwrap(function)
    sources = b"".join(Path(__file__).with_name(name).read_bytes() for name in SOURCES)
    function.__qualname__ += f"_{hashlib.sha256(sources).hexdigest()[:16]}"
    return entry(function)
