"""Spreads blocks over threads: compiled loops release the GIL (Numba's layers were slower beside torch's OpenMP)."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise


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
