"""Spreads blocks over threads: kernels release the GIL (Numba's own layers were slower beside torch's OpenMP)."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from itertools import pairwise

import torch

_spread_over: ContextVar[int | None] = ContextVar("spread_over", default=None)


def spread(blocks: int, kernel: Callable[..., None], *arguments: object) -> None:
    """Call `kernel(first, last, *arguments)` on parts of the blocks, one in each of torch's number of threads."""
    threads = min(_spread_over.get() or torch.get_num_threads(), blocks)
    if threads <= 1:
        return kernel(0, blocks, *arguments)
    cuts = [blocks * i // threads for i in range(threads + 1)]
    futures = [_pool(threads).submit(kernel, *part, *arguments) for part in pairwise(cuts)]
    for future in futures:
        future.result()


@contextmanager
def only_kernels_spread() -> Iterator[None]:
    """Within, torch's own operations keep to one thread.

    After each that does not, OpenMP's threads spin for milliseconds, on the cores that the kernels want.
    """
    threads = torch.get_num_threads()
    token = _spread_over.set(_spread_over.get() or threads)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        _spread_over.reset(token)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="offpiste-kernels")


if hasattr(os, "register_at_fork"):  # threads do not survive a fork
    os.register_at_fork(after_in_child=_pool.cache_clear)
