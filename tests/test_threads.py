"""Which parts of the blocks the threads get."""

import threading

import pytest

from offpiste.threads import spread


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
@pytest.mark.parametrize("blocks", [1, 2, 5, 7])
def test_every_block_is_in_one_part(threads, blocks):
    found, callers = [], set()

    def loop(first, last, told):
        assert told == "told"
        found.extend(range(first, last))
        callers.add(threading.current_thread())

    spread(threads, blocks, loop, "told")
    assert sorted(found) == list(range(blocks))
    assert threading.current_thread() in callers, "the caller works too"


def test_what_fails_in_a_thread_fails_here():
    def loop(first, last):
        if first:
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        spread(2, 2, loop)
