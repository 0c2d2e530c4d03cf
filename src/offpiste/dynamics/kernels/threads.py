"""Spreads blocks over threads: kernels release the GIL (Numba's own layers were slower beside torch's OpenMP)."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import torch


def spread(blocks: int, kernel: Callable[..., None], *arguments: object) -> None:
    """Call `kernel(first, last, *arguments)` on parts of the blocks, one in each of torch's number of threads."""
    threads = min(torch.get_num_threads(), blocks)
    if threads <= 1:
        return kernel(0, blocks, *arguments)
    cuts = [blocks * i // threads for i in range(threads + 1)]
    futures = [_pool(threads).submit(kernel, *part, *arguments) for part in pairwise(cuts)]
    for future in futures:
        future.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="offpiste-kernels")


if hasattr(os, "register_at_fork"):  # threads do not survive a fork
    os.register_at_fork(after_in_child=_pool.cache_clear)
