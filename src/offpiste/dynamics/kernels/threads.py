"""How many threads the kernels are spread over."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch

from offpiste import threads

_spread_over: ContextVar[int | None] = ContextVar("spread_over", default=None)


def spread(blocks: int, kernel: Callable[..., None], *arguments: object) -> None:
    """Call `kernel(first, last, *arguments)` on parts of the blocks, one in each of torch's number of threads."""
    threads.spread(_spread_over.get() or torch.get_num_threads(), blocks, kernel, *arguments)


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
