"""Compilation of loops by Numba, and threads over their blocks (Numba's own were slower beside torch's OpenMP)."""

import hashlib
import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Set
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler as NumbaCompiler
from numba.core.registry import cpu_target
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
        wide: use vectors of 512 bits if available (LLVM prefers 256 on Intel). Sums over lanes round differently.
        part: name for the message before compilation; "" for no message.
        seconds: duration of the compilation.
    """

    sources: tuple[str, ...]
    fastmath: Set[str] = frozenset()
    loops_make_arrays: bool = True
    entries_make_arrays: bool = True
    wide: bool = False
    part: str = ""
    seconds: int = 0

    def inlined(self, function: Function) -> Function:
        """Compile a function that is inlined into its callers."""
        return _compiled(function, forceinline=True, **self._options(self.loops_make_arrays))

    def loop(self, function: Function) -> Function:
        """Compile a function for other compiled functions."""
        return _compiled(function, **self._options(self.loops_make_arrays))

    def summing_loop(self, function: Function) -> Function:
        """Compile a function for other compiled functions that may sum in any order."""
        options = self._options(self.loops_make_arrays)
        return _compiled(function, **options | {"fastmath": {*self.fastmath, "reassoc"}})

    def maker(self, function: Function) -> Function:
        """Compile a function for other compiled functions that creates arrays."""
        return _compiled(function, **self._options(makes_arrays=True))

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
        options["pipeline_class"] = WideSelfContained if self.wide else SelfContained
        entry: Any = _compiled(function, **options)
        with suppress(RuntimeError):  # the cache has no folder
            entry._cache = KernelCache(entry.py_func, self.part, self.seconds)
            entry._compiler.compile = entry._cache.compiling(entry._compiler.compile)
        return entry  # type: ignore[no-any-return]

    def _options(self, makes_arrays: bool) -> dict[str, Any]:
        options: dict[str, Any] = {"pipeline_class": Wide} if self.wide else {}
        options |= {} if makes_arrays else {"_nrt": False}
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


def target_machine() -> list[str]:
    """Return platform, processor and features that kernels are compiled for; others may round differently."""
    return [str(part) for part in cpu_target.target_context.codegen().magic_tuple()]


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


class _WideVectors(JITCodeLibrary):  # type: ignore[misc]
    """Machine code with the widest vectors of the processor."""

    def add_ir_module(self, ir_module: Any) -> None:
        """Set the preference per function; an option of LLVM would hold for the whole process."""
        for function in ir_module.functions:
            if not function.is_declaration:
                # llvmlite's `add` accepts only attributes without values.
                set.add(function.attributes, '"prefer-vector-width"="512"')
        super().add_ir_module(ir_module)  # type: ignore[no-untyped-call]


class _WideOwnCopies(_OwnCopies, _WideVectors):
    """Machine code with internal copies and the widest vectors."""


class Wide(SelfContained):
    """Numba compiler for called functions, with wide vectors."""

    library = _WideVectors


class WideSelfContained(SelfContained):
    """`SelfContained` with wide vectors."""

    library = _WideOwnCopies


def _compiled(function: Function, **options: Any) -> Function:
    # Tests wrap functions to check types; Numba needs the wrapped function.
    return numba.njit(error_model="numpy", **options)(inspect.unwrap(function))  # type: ignore[no-any-return]


FUSED: Final = frozenset({"contract"})
"""Fast-math flags of fused multiply-add alone."""

MAPPING: Final = Compiler(
    ("mapping",), FUSED, loops_make_arrays=False, entries_make_arrays=False, part="the map's kernels", seconds=20
)
POSES: Final = Compiler(("logs/poses.py",), loops_make_arrays=False, entries_make_arrays=False)
MOTION: Final = Compiler(("perception/motion_compensation.py",), loops_make_arrays=False, entries_make_arrays=False)
PROJECTION: Final = Compiler(("perception/projection.py",), loops_make_arrays=False, entries_make_arrays=False)
FUSED_PROJECTION: Final = replace(PROJECTION, fastmath=FUSED)
CLOUDS: Final = Compiler(("logs/usable_points.py",), loops_make_arrays=False, entries_make_arrays=False)
FUSED_CLOUDS: Final = replace(CLOUDS, fastmath=FUSED)
"""Compilers of loops over points of scans, with fused multiply-add where BLAS uses it."""
OCCLUSION: Final = Compiler(("perception/projection.py",))
_RESPONSES: Final = ("perception/filter_responses.py",)
FILTERS: Final = Compiler(_RESPONSES, FUSED, loops_make_arrays=False, entries_make_arrays=False)
FILTER_SUMS: Final = Compiler(_RESPONSES, loops_make_arrays=False, entries_make_arrays=False)
"""Compilers of the backbone `filterbank`, with and without fused multiply-add."""
FEATURE_SETS_KEPT: Final = Compiler(("dataset/feature_sets.py",), loops_make_arrays=False, entries_make_arrays=False)
_STEP: Final = (
    "dynamics/kernels",
    *(f"dynamics/{name}.py" for name in ("actuator_lags", "bicycle", "lstm")),
    "core/channels.py",
    "core/conventions.py",
    "mapping/terrain_map.py",
)
"""Sources of a step, including modules of its constants."""
KERNELS: Final = Compiler(
    _STEP,
    FUSED,
    loops_make_arrays=False,
    wide=True,
    part="the kernels of training",
    seconds=20,
)
PLANNING: Final = Compiler(
    (*_STEP, "planning", "uncertainty/spread.py"),
    FUSED,
    loops_make_arrays=False,
    wide=True,
    part="the planner's kernels",
    seconds=20,
)
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


def spread_blocks(threads: int, blocks: int, loop: Callable[..., None], *arguments: object) -> None:
    """Call `loop(first, last, *arguments)` on contiguous ranges of blocks, one per thread."""
    threads = min(threads, blocks)
    if threads <= 1:
        return loop(0, blocks, *arguments)
    cuts = [blocks * i // threads for i in range(threads + 1)]
    first, *others = pairwise(cuts)
    futures = [_pool(threads).submit(loop, *part, *arguments) for part in others]
    loop(*first, *arguments)
    for future in futures:
        future.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads - 1, thread_name_prefix="offpiste")


if hasattr(os, "register_at_fork"):  # threads do not survive a fork
    os.register_at_fork(after_in_child=_pool.cache_clear)


_kernel_threads: ContextVar[int | None] = ContextVar("kernel_threads", default=None)


def spread_kernel(blocks: int, kernel: Callable[..., None], *arguments: object) -> None:
    """Call `kernel(first, last, *arguments)` on contiguous ranges of blocks, with as many threads as torch."""
    import torch  # takes a second and 150 MB, and most compiled code runs without it

    spread_blocks(_kernel_threads.get() or torch.get_num_threads(), blocks, kernel, *arguments)


@contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Run torch's own operations in one thread; kernels use as many as before.

    OpenMP's threads spin for milliseconds after each operation, on cores that kernels need.
    """
    import torch

    before = torch.get_num_threads()
    token = _kernel_threads.set(_kernel_threads.get() or before)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        _kernel_threads.reset(token)
