"""Compiled loops: how Numba compiles them, and how their blocks are spread over threads.

Numba's own threading layers were slower beside torch's OpenMP.
"""

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
    """Compiler options of one part of offpiste.

    Attributes:
        sources: folders and files, relative to the package, whose code an entry may call, or whose constants it reads.
        fastmath: fast-math flags of LLVM; none assumes finite numbers, since diverged rollouts must be detected.
        loops_make_arrays, entries_make_arrays: whether such functions create or keep arrays. Those that do not are
            compiled without reference counting, and run up to three times as fast; they cannot assign slices, which
            may need a copy.
        wide: whether loops use vectors of 512 bits where there are such; LLVM alone prefers 256 on Intel's processors,
            whose first ones lowered their clock for them. Sums over lanes round differently.
        part: what is compiled, for the message before it; "" for none.
        seconds: that it takes.
    """

    sources: tuple[str, ...]
    fastmath: Set[str] = frozenset()
    loops_make_arrays: bool = True
    entries_make_arrays: bool = True
    wide: bool = False
    part: str = ""
    seconds: int = 0

    def inlined(self, function: Function) -> Function:
        """Compile a function that becomes part of the loop that calls it."""
        return _compiled(function, forceinline=True, **self._options(self.loops_make_arrays))

    def loop(self, function: Function) -> Function:
        """Compile a function that other compiled functions call, once for all callers."""
        return _compiled(function, **self._options(self.loops_make_arrays))

    def summing_loop(self, function: Function) -> Function:
        """Compile a function for other compiled functions that may sum numbers in any order."""
        options = self._options(self.loops_make_arrays)
        return _compiled(function, **options | {"fastmath": {*self.fastmath, "reassoc"}})

    def maker(self, function: Function) -> Function:
        """Compile a function for other compiled functions that creates arrays."""
        return _compiled(function, **self._options(makes_arrays=True))

    def entry(self, function: Function, *, salt: str = "") -> Function:
        """Compile a function that Python calls; it releases the GIL, and its code is kept (`KernelCache`) if possible.

        It calls its own copies of other functions (`SelfContained`), so that it gives the same bits in every process.

        Numba checks only the file of the function itself to see whether the cache is still valid, hence the digest of
        all sources in its name.

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
        with suppress(RuntimeError):  # no folder for the cache
            entry._cache = KernelCache(entry.py_func, self.part, self.seconds)
            entry._compiler.compile = entry._cache.compiling(entry._compiler.compile)
        return entry  # type: ignore[no-any-return]

    def _options(self, makes_arrays: bool) -> dict[str, Any]:
        options: dict[str, Any] = {"pipeline_class": Wide} if self.wide else {}
        options |= {} if makes_arrays else {"_nrt": False}
        return options | ({"fastmath": set(self.fastmath)} if self.fastmath else {})

    @cached_property
    def _digest(self) -> str:
        # This file, too: options are no part of the key of Numba's cache.
        return sources_digest(("native/compilation.py", *self.sources))[:16]


def sources_digest(sources: Iterable[str]) -> str:
    """SHA-256 of the code in files and folders, relative to the package.

    Raises:
        FileNotFoundError: a source does not exist.
    """
    roots = [Path(__file__).parents[1] / source for source in sources]
    files = [file for root in roots for file in (sorted(root.rglob("*.py")) if root.is_dir() else [root])]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def target_machine() -> list[str]:
    """Platform, processor and its features that kernels are compiled for: others may round differently."""
    return [str(part) for part in cpu_target.target_context.codegen().magic_tuple()]


class _OwnCopies(JITCodeLibrary):  # type: ignore[misc]
    """Machine code that binds its copies of the functions that it calls to itself."""

    def _finalize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        super()._finalize_final_module()  # type: ignore[no-untyped-call]


class SelfContained(NumbaCompiler):  # type: ignore[misc]
    """Numba's compiler for functions whose machine code calls nothing outside of it but the runtime.

    Numba links a copy of every function that is called into the caller, optimises it there once more, and leaves its
    symbol weak. The linker then takes the first definition in the process: where the callee was compiled just before,
    the callee's own; where the caller is loaded from the cache, the copy, or that of another caller that was loaded
    earlier. They round differently: after 50 steps of a plan by 1e-7.
    """

    library: type[JITCodeLibrary] = _OwnCopies
    """Class of the machine code."""

    def define_pipelines(self) -> Any:
        """Numba's passes, into a library whose copies are its own."""
        target, name = self.state.targetctx.codegen(), self.state.func_id.func_qualname
        self.state.library = self.library(target, name)  # type: ignore[no-untyped-call]
        self.state.library.enable_object_caching()
        return super().define_pipelines()  # type: ignore[no-untyped-call]


class _WideVectors(JITCodeLibrary):  # type: ignore[misc]
    """Machine code with vectors as wide as the processor has them."""

    def add_ir_module(self, ir_module: Any) -> None:
        """Put the preference on each function: as an option of LLVM it would be one of the whole process."""
        for function in ir_module.functions:
            if not function.is_declaration:
                # Their own `add` knows attributes without values only.
                set.add(function.attributes, '"prefer-vector-width"="512"')
        super().add_ir_module(ir_module)  # type: ignore[no-untyped-call]


class _WideOwnCopies(_OwnCopies, _WideVectors):
    """Both."""


class Wide(SelfContained):
    """Numba's compiler for functions that others call, with wide vectors."""

    library = _WideVectors


class WideSelfContained(SelfContained):
    """`SelfContained` with wide vectors."""

    library = _WideOwnCopies


def _compiled(function: Function, **options: Any) -> Function:
    # Tests wrap every function of offpiste to check types; Numba needs the wrapped function.
    return numba.njit(error_model="numpy", **options)(inspect.unwrap(function))  # type: ignore[no-any-return]


FUSED: Final = frozenset({"contract"})
"""Fast-math flags: fused multiply-add, and nothing else."""

MAPPING: Final = Compiler(
    ("mapping",), FUSED, loops_make_arrays=False, entries_make_arrays=False, part="the map's kernels", seconds=20
)
POSES: Final = Compiler(("logs/poses.py",), loops_make_arrays=False, entries_make_arrays=False)
MOTION: Final = Compiler(("perception/motion_compensation.py",), loops_make_arrays=False, entries_make_arrays=False)
PROJECTION: Final = Compiler(("perception/projection.py",), loops_make_arrays=False, entries_make_arrays=False)
FUSED_PROJECTION: Final = replace(PROJECTION, fastmath=FUSED)
CLOUDS: Final = Compiler(("logs/usable_points.py",), loops_make_arrays=False, entries_make_arrays=False)
FUSED_CLOUDS: Final = replace(CLOUDS, fastmath=FUSED)
"""Compilers of loops over the points of scans: products fused with the sums that they go into where BLAS does it."""
OCCLUSION: Final = Compiler(("perception/occlusion.py",))
_RESPONSES: Final = ("perception/filter_responses.py",)
FILTERS: Final = Compiler(_RESPONSES, FUSED, loops_make_arrays=False, entries_make_arrays=False)
FILTER_SUMS: Final = Compiler(_RESPONSES, loops_make_arrays=False, entries_make_arrays=False)
"""Compilers of the backbone `filterbank`: products fused with the sums that they go into, and not."""
FEATURE_SETS_KEPT: Final = Compiler(("dataset/feature_sets.py",), loops_make_arrays=False, entries_make_arrays=False)
_STEP: Final = (
    "dynamics/kernels",
    *(f"dynamics/{name}.py" for name in ("actuator_lags", "bicycle", "inputs", "lstm")),
    "core/channels.py",
    "core/conventions.py",
    "mapping/terrain_map.py",
)
"""What a step is compiled from, modules with its constants included."""
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
"""Compiler of the simulated vehicle: functions of scalars for Python and for each other, without fast math."""
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
    """Call a C function that returns nothing from compiled code: its address, and a tuple of addresses to give it."""

    def build(_target, builder, _signature, values):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        address, given = values[0], cgutils.unpack_tuple(builder, values[1])  # type: ignore[no-untyped-call]
        kind = ir.FunctionType(ir.VoidType(), [pointer] * len(given)).as_pointer()
        builder.call(builder.inttoptr(address, kind), [builder.inttoptr(value, pointer) for value in given])
        return ir.Constant(ir.IntType(32), 0)

    return types.int32(types.intp, types.UniTuple(types.intp, len(arguments))), build  # type: ignore[no-untyped-call]


def spread_blocks(threads: int, blocks: int, loop: Callable[..., None], *arguments: object) -> None:
    """Call `loop(first, last, *arguments)` on contiguous parts of the blocks, one in each thread."""
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
    """Call `kernel(first, last, *arguments)` on contiguous parts of the blocks, in as many threads as torch uses."""
    import torch  # here, because it takes a second and 150 MB, and most of what is compiled runs without it

    spread_blocks(_kernel_threads.get() or torch.get_num_threads(), blocks, kernel, *arguments)


@contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Context in which torch's own operations use one thread; kernels use as many as before.

    After each multi-threaded operation OpenMP's threads spin for milliseconds, on cores that the kernels need.
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
