"""Which parts of the blocks the threads get, and that torch keeps out of their way."""

import pytest
import torch

from offpiste.threads import only_kernels_spread
from offpiste.threads import spread_threads as spread


@pytest.fixture(autouse=True)
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def parts(blocks):
    found = []
    spread(blocks, lambda first, last: found.append((first, last)))
    return sorted(found)


def test_every_block_is_in_one_part():
    assert parts(5) == [(0, 2), (2, 5)]
    assert parts(1) == [(0, 1)]


def test_kernels_spread_as_before_where_torch_does_not():
    with only_kernels_spread():
        assert torch.get_num_threads() == 1
        assert parts(4) == [(0, 2), (2, 4)]
        with only_kernels_spread():
            assert parts(4) == [(0, 2), (2, 4)]
        assert parts(4) == [(0, 2), (2, 4)]
    assert torch.get_num_threads() == 2


def test_torch_has_its_threads_back_after_an_error():
    with pytest.raises(ValueError, match="no"), only_kernels_spread():
        raise ValueError("no")
    assert torch.get_num_threads() == 2
    torch.set_num_threads(1)
    assert parts(4) == [(0, 4)]
