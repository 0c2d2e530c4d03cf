"""Spread blocks of work over threads; compiled loops release the GIL.

Numba's own threading layers were slower beside torch's OpenMP.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from itertools import pairwise

import torch


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
    spread_blocks(_kernel_threads.get() or torch.get_num_threads(), blocks, kernel, *arguments)


@contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Context in which torch's own operations use one thread; kernels use as many as before.

    After each multi-threaded operation OpenMP's threads spin for milliseconds, on cores that the kernels need.
    """
    before = torch.get_num_threads()
    token = _kernel_threads.set(_kernel_threads.get() or before)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        _kernel_threads.reset(token)
