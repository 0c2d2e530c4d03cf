"""Codes under wheels: numbers and gradients of plain indexing, on every way that there is."""

import pytest
import torch

from offpiste.training.codes_of_cells import codes_of_cells

WAYS = [(torch.float32, 4), (torch.float64, 4), (torch.float64, 2), (torch.float64, 1), (torch.float16, 8)]
"""Kernels of the CPU, rows of other lengths, and rows of 16 bytes."""


def read(way=codes_of_cells, dtype=torch.float64, size=4, cells=None) -> tuple[torch.Tensor, torch.Tensor]:
    """Codes and the gradient of a weighted sum; a quarter of the cells is never read."""
    draw = torch.Generator().manual_seed(0)
    cells = torch.randint(0, 225, (64, 250, 4), generator=draw) if cells is None else cells
    codes = torch.randn(300, size, generator=draw).to(dtype).requires_grad_()
    weight = torch.randn(*cells.shape, size, generator=draw).to(dtype)
    found = way(codes, cells)
    (found * weight).sum().backward()
    return found.detach(), codes.grad


def plain(codes: torch.Tensor, cells: torch.Tensor) -> torch.Tensor:
    return codes[cells]


@pytest.mark.parametrize(("dtype", "size"), WAYS)
def test_codes_and_gradients_are_those_of_indexing_and_always_the_same(dtype, size) -> None:
    """Indexing's own gradient adds what several threads bring in the order in which they come."""
    threads = torch.get_num_threads()
    torch.set_num_threads(4)
    try:
        (codes, first), *others = (read(dtype=dtype, size=size) for _ in range(6))
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(first, gradient) for _, gradient in others)
    expected, gradient = read(plain, dtype, size)
    assert torch.equal(codes, expected)
    tolerance = {torch.float16: 0.5, torch.float32: 1e-4, torch.float64: 1e-10}[dtype]
    torch.testing.assert_close(first, gradient, atol=tolerance, rtol=0.02 if dtype == torch.float16 else 1e-5)
    assert (first[225:] == 0).all()
    assert (first[:225] != 0).any(dim=1).all()


@pytest.mark.parametrize(("dtype", "size"), WAYS)
def test_unknown_codes_stay_in_their_cell_and_nothing_read_is_no_gradient(dtype, size) -> None:
    codes = torch.zeros(3, size, dtype=dtype)
    codes[1] = torch.nan
    found = codes_of_cells(codes, torch.tensor([[1, 0], [2, 1]]))
    assert found.isnan().all(dim=-1).tolist() == [[True, False], [False, True]]
    empty, gradient = read(dtype=dtype, size=size, cells=torch.zeros((0, 4), dtype=torch.int64))
    assert empty.shape == (0, 4, size)
    assert (gradient == 0).all()
