"""Numba, as all of offpiste uses it: functions that compiled loops call, and functions that Python calls."""

import hashlib
import inspect
from collections.abc import Callable, Set
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numba

Function = Callable[..., Any]


@dataclass(frozen=True)
class Compiler:
    """How one part of offpiste compiles its loops.

    Attributes:
        sources: folders and files, relative to the package, whose code an entry may call.
        fastmath: liberties that LLVM may take; none assumes that numbers are finite, since a diverged rollout must
            say so.
        loops_make_arrays, entries_make_arrays: whether such functions make or keep arrays. Those that do not need not
            count references to arrays, and run up to three times as fast without; they cannot assign slices then,
            which may need a copy.
    """

    sources: tuple[str, ...]
    fastmath: Set[str] = frozenset()
    loops_make_arrays: bool = True
    entries_make_arrays: bool = True

    def inlined(self, function: Function) -> Function:
        """Compile a function that becomes part of the loop that calls it."""
        return _compiled(function, forceinline=True, **self._options(self.loops_make_arrays))

    def loop(self, function: Function) -> Function:
        """Compile a function that other compiled functions call: once, not anew wherever it is called."""
        return _compiled(function, **self._options(self.loops_make_arrays))

    def summing_loop(self, function: Function) -> Function:
        """Compile a function that adds up numbers in any order, for other compiled functions."""
        options = self._options(self.loops_make_arrays)
        return _compiled(function, **options | {"fastmath": {*self.fastmath, "reassoc"}})

    def maker(self, function: Function) -> Function:
        """Compile a function that makes arrays, for other compiled functions."""
        return _compiled(function, **self._options(makes_arrays=True))

    def entry(self, function: Function, *, salt: str = "") -> Function:
        """Compile a function that Python calls; it releases the GIL, and its machine code is kept on disk if possible.

        Numba looks only at the file of the function itself to see whether what it kept is still valid, hence a digest
        of all sources in its name.

        Args:
            salt: other code that the function calls.
        """
        function = inspect.unwrap(function)
        function.__qualname__ += f"_{self._digest}"
        if salt:
            function.__qualname__ += f"_{hashlib.sha256(salt.encode()).hexdigest()[:16]}"
        options = self._options(self.entries_make_arrays) | {"nogil": True}
        try:
            return _compiled(function, cache=True, **options)
        except RuntimeError:  # no folder to keep it in
            return _compiled(function, **options)

    def _options(self, makes_arrays: bool) -> dict[str, Any]:
        options: dict[str, Any] = {} if makes_arrays else {"_nrt": False}
        return options | ({"fastmath": set(self.fastmath)} if self.fastmath else {})

    @cached_property
    def _digest(self) -> str:
        package = Path(__file__).parent
        roots = [package / source for source in self.sources]
        files = [file for root in roots for file in ([root] if root.is_file() else sorted(root.rglob("*.py")))]
        return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _compiled(function: Function, **options: Any) -> Function:
    # Tests wrap every function of offpiste to check its types; Numba needs what is inside.
    return numba.njit(error_model="numpy", **options)(inspect.unwrap(function))  # type: ignore[no-any-return]


FUSED: Final = frozenset({"contract"})
"""Fused multiply-add, and nothing else."""

MAPPING: Final = Compiler(("mapping",), FUSED, loops_make_arrays=False, entries_make_arrays=False)
OCCLUSION: Final = Compiler(("perception/occlusion.py",))
KERNELS: Final = Compiler(("dynamics/kernels",), FUSED, loops_make_arrays=False)
PLANNING: Final = Compiler(
    ("dynamics/kernels", "planning", "mapping/map_cells.py", "mapping/wheel_positions.py"),
    FUSED,
    loops_make_arrays=False,
)
PHYSICS: Final = Compiler(("simulation",))
"""The simulated vehicle: functions of scalars for Python and for each other, without any liberty."""
RAYS: Final = Compiler(("simulation",), frozenset({"contract", "nsz", "arcp"}))
"""The simulated sensors."""
