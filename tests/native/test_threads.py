"""Threads over parts of a computation."""

import threading
import time

import pytest
import torch

from factories import torch_threads
from offpiste.native.threads import single_threaded_torch, spread_blocks, spread_kernel


@pytest.mark.parametrize(("threads", "blocks"), [(1, 5), (2, 1), (3, 7), (8, 5)])
def test_every_block_is_in_one_part(threads, blocks):
    done, callers = [], set()

    def loop(first, last, given):
        assert given == "given"
        done.extend(range(first, last))
        callers.add(threading.current_thread())

    spread_blocks(threads, blocks, loop, "given")
    assert sorted(done) == list(range(blocks))
    assert threading.current_thread() in callers, "the caller works too"


def test_an_error_in_a_thread_is_raised_in_the_caller():
    def loop(first, last):
        if first:
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        spread_blocks(2, 2, loop)


def test_an_error_leaves_no_thread_at_work():
    done = []

    def loop(first, last):
        if first == 0:
            raise KeyboardInterrupt
        time.sleep(0.2)
        done.append(first)

    with pytest.raises(KeyboardInterrupt):
        spread_blocks(2, 2, loop)
    assert done, "arrays may be freed from now on"


def parts(blocks):
    found = []
    spread_kernel(blocks, lambda first, last: found.append((first, last)))
    return sorted(found)


@torch_threads(2)
def test_kernels_use_as_many_threads_as_torch():
    assert parts(5) == [(0, 2), (2, 5)]
    with single_threaded_torch():
        assert torch.get_num_threads() == 1
        assert parts(4) == [(0, 2), (2, 4)]
        with single_threaded_torch():
            assert parts(4) == [(0, 2), (2, 4)]
        assert parts(4) == [(0, 2), (2, 4)]
    assert torch.get_num_threads() == 2


@torch_threads(2)
def test_torch_has_its_threads_back_after_an_error():
    with pytest.raises(ValueError, match="no"), single_threaded_torch():
        raise ValueError("no")
    assert torch.get_num_threads() == 2
    torch.set_num_threads(1)
    assert parts(4) == [(0, 4)]
