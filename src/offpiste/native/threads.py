"""Threads over independent parts of a computation; compiled code releases the GIL."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from itertools import pairwise


def spread_blocks(threads: int, blocks: int, loop: Callable[..., object], *arguments: object) -> None:
    """Call `loop(first, last, *arguments)` on contiguous ranges of blocks, one per thread."""
    threads = min(threads, blocks)
    if threads <= 1:
        loop(0, blocks, *arguments)
        return
    cuts = [blocks * i // threads for i in range(threads + 1)]
    first, *others = pairwise(cuts)
    futures = [_pool(threads).submit(loop, *part, *arguments) for part in others]
    try:
        loop(*first, *arguments)
    finally:
        wait(futures)  # the arrays may be freed after an error
    for future in futures:
        future.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads - 1, thread_name_prefix="offpiste")


if hasattr(os, "register_at_fork"):  # threads do not survive a fork
    os.register_at_fork(after_in_child=_pool.cache_clear)


_kernel_threads: ContextVar[int | None] = ContextVar("kernel_threads", default=None)


def spread_kernel(blocks: int, kernel: Callable[..., object], *arguments: object) -> None:
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
