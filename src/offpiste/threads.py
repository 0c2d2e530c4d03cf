"""Spreads blocks over threads: compiled loops release the GIL (Numba's layers were slower beside torch's OpenMP).

How many threads the kernels are spread over.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from itertools import pairwise

import torch


def spread(threads: int, blocks: int, loop: Callable[..., None], *arguments: object) -> None:
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


_spread_over: ContextVar[int | None] = ContextVar("spread_over", default=None)


def spread_threads(blocks: int, kernel: Callable[..., None], *arguments: object) -> None:
    """Call `kernel(first, last, *arguments)` on parts of the blocks, one in each of torch's number of threads."""
    spread(_spread_over.get() or torch.get_num_threads(), blocks, kernel, *arguments)


@contextmanager
def only_kernels_spread() -> Iterator[None]:
    """Within, torch's own operations keep to one thread.

    After each that does not, OpenMP's threads spin for milliseconds, on the cores that the kernels want.
    """
    before = torch.get_num_threads()
    token = _spread_over.set(_spread_over.get() or before)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        _spread_over.reset(token)
