"""Compilation of loops by Numba."""

import hashlib
import inspect
from collections.abc import Callable, Iterable, Set
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler as NumbaCompiler
from numba.extending import intrinsic

from offpiste.native.kernel_cache import KernelCache

Function = Callable[..., Any]


@dataclass(frozen=True)
class Compiler:
    """Compiler options of a group of functions.

    Attributes:
        sources: folders and files, relative to the package, of all functions and constants that an entry uses.
        fastmath: fast-math flags of LLVM. None may assume finite numbers: diverged rollouts must be detected.
        loops_make_arrays, entries_make_arrays: whether these functions create or keep arrays. Others are compiled
            without reference counting and are up to three times as fast, but cannot assign slices.
        part: name for the message before compilation; "" for no message.
        seconds: duration of the compilation.
    """

    sources: tuple[str, ...]
    fastmath: Set[str] = frozenset()
    loops_make_arrays: bool = True
    entries_make_arrays: bool = True
    part: str = ""
    seconds: int = 0

    def inlined(self, function: Function) -> Function:
        """Compile a function that is inlined into its callers."""
        return _compiled(function, forceinline=True, **self._options(self.loops_make_arrays))

    def loop(self, function: Function) -> Function:
        """Compile a function for other compiled functions."""
        return _compiled(function, **self._options(self.loops_make_arrays))

    def entry(self, function: Function, *, salt: str = "") -> Function:
        """Compile a function for Python; it releases the GIL and is cached (`KernelCache`).

        Numba invalidates its cache only by the file of the function, hence the digest of all sources in its name.

        Args:
            salt: other code that the function calls.
        """
        function = inspect.unwrap(function)
        function.__qualname__ += f"_{self._digest}"
        if salt:
            function.__qualname__ += f"_{hashlib.sha256(salt.encode()).hexdigest()[:16]}"
        options = self._options(self.entries_make_arrays) | {"nogil": True}
        options["pipeline_class"] = SelfContained
        entry: Any = _compiled(function, **options)
        with suppress(RuntimeError):  # the cache has no folder
            entry._cache = KernelCache(entry.py_func, self.part, self.seconds)
            entry._compiler.compile = entry._cache.compiling(entry._compiler.compile)
        return entry  # type: ignore[no-any-return]

    def _options(self, makes_arrays: bool) -> dict[str, Any]:
        options: dict[str, Any] = {} if makes_arrays else {"_nrt": False}
        return options | ({"fastmath": set(self.fastmath)} if self.fastmath else {})

    @cached_property
    def _digest(self) -> str:
        # This file as well: compiler options are not in the key of Numba's cache.
        return sources_digest(("native/compilation.py", *self.sources))[:16]


def sources_digest(sources: Iterable[str]) -> str:
    """Return the SHA-256 of the code in files and folders, relative to the package."""
    roots = [Path(__file__).parents[1] / source for source in sources]
    files = [file for root in roots for file in (sorted(root.rglob("*.py")) if root.is_dir() else [root])]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


class _OwnCopies(JITCodeLibrary):  # type: ignore[misc]
    """Machine code whose copies of called functions are internal."""

    def _finalize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        super()._finalize_final_module()  # type: ignore[no-untyped-call]


class SelfContained(NumbaCompiler):  # type: ignore[misc]
    """Numba compiler whose machine code depends on no earlier compilation in the process.

    Numba links a copy of every called function into the caller, optimises it again, and leaves its symbol weak. The
    linker takes the first definition in the process, and these round differently (by 1e-7 after 50 steps of a plan).
    """

    library: type[JITCodeLibrary] = _OwnCopies

    def define_pipelines(self) -> Any:
        """Return Numba's passes, with the code library of this class."""
        target, name = self.state.targetctx.codegen(), self.state.func_id.func_qualname
        self.state.library = self.library(target, name)  # type: ignore[no-untyped-call]
        self.state.library.enable_object_caching()
        return super().define_pipelines()  # type: ignore[no-untyped-call]


def _compiled(function: Function, **options: Any) -> Function:
    # Tests wrap functions to check types; Numba needs the wrapped function.
    return numba.njit(error_model="numpy", **options)(inspect.unwrap(function))  # type: ignore[no-any-return]


FUSED: Final = frozenset({"contract"})
"""Fast-math flags of fused multiply-add alone."""

MOTION: Final = Compiler(("perception/motion_compensation.py",), loops_make_arrays=False, entries_make_arrays=False)
PROJECTION: Final = Compiler(("perception/projection.py",), loops_make_arrays=False, entries_make_arrays=False)
FUSED_PROJECTION: Final = replace(PROJECTION, fastmath=FUSED)
"""Compilers of loops over points of scans, with fused multiply-add where BLAS uses it."""
OCCLUSION: Final = Compiler(("perception/projection.py",))
_RESPONSES: Final = ("perception/filter_responses.py",)
FILTERS: Final = Compiler(_RESPONSES, FUSED, loops_make_arrays=False, entries_make_arrays=False)
FILTER_SUMS: Final = Compiler(_RESPONSES, loops_make_arrays=False, entries_make_arrays=False)
"""Compilers of the backbone `filterbank`, with and without fused multiply-add."""
PHYSICS: Final = Compiler(("simulation", "core/conventions.py"), part="the simulated vehicle", seconds=10)
"""Compiler of the simulated vehicle, without fast math."""
RAYS: Final = Compiler(
    ("simulation",),
    frozenset({"contract", "nsz", "arcp"}),
    loops_make_arrays=False,
    entries_make_arrays=False,
    part="the simulated sensors",
    seconds=10,
)
"""Compiler of the simulated sensors."""


@intrinsic  # type: ignore[misc]
def call_address(_context, function, arguments):  # type: ignore[no-untyped-def]
    """Call a void C function from compiled code, given its address and a tuple of addresses as arguments."""

    def build(_target, builder, _signature, values):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        address, given = values[0], cgutils.unpack_tuple(builder, values[1])  # type: ignore[no-untyped-call]
        kind = ir.FunctionType(ir.VoidType(), [pointer] * len(given)).as_pointer()
        builder.call(builder.inttoptr(address, kind), [builder.inttoptr(value, pointer) for value in given])
        return ir.Constant(ir.IntType(32), 0)

    return types.int32(types.intp, types.UniTuple(types.intp, len(arguments))), build  # type: ignore[no-untyped-call]
