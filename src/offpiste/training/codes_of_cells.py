"""Codes of the cells under wheels, whose gradients are the same in every process and every run."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from offpiste.dynamics.kernels.encoder import codes_under_wheels


def codes_of_cells(codes: Float[Tensor, "M E"], cells: Int[Tensor, "*S"]) -> Float[Tensor, "*S E"]:
    """`codes[cells]`; indexing's own gradient adds up in the order in which threads come."""
    if codes.device.type == "cpu" and codes.dtype == torch.float32:
        return codes_under_wheels(codes, cells)
    return _Take.apply(codes, cells)  # type: ignore[no-untyped-call, no-any-return]


class _Take(torch.autograd.Function):
    """Codes of cells, and the sum of their adjoints by cell, in the order of `cells`."""

    @staticmethod
    def forward(ctx: Any, codes: Tensor, cells: Tensor) -> Tensor:
        """Codes [*S, E]."""
        ctx.cells, ctx.count = cells, len(codes)
        return _rows(codes, cells)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bar: Tensor) -> tuple[Tensor, None]:
        """Adjoint of the codes."""
        if not ctx.cells.numel():
            return bar.new_zeros(ctx.count, bar.shape[-1]), None
        cells, order = torch.sort(ctx.cells.flatten().int(), stable=True)  # half the bits are sorted in half the time
        first = torch.searchsorted(cells, torch.arange(ctx.count + 1, dtype=cells.dtype, device=cells.device))
        by_cell = _rows(bar.reshape(-1, bar.shape[-1]), order)
        return torch.segment_reduce(by_cell, "sum", offsets=first, axis=0, initial=0, unsafe=True), None


def _rows(values: Float[Tensor, "M E"], index: Int[Tensor, "*S"]) -> Float[Tensor, "*S E"]:
    """`values[index]`; rows of 16 bytes are read as one number each, a fiftieth of the time on a GPU (docs/gpu.md)."""
    if values.shape[1] * values.element_size() != 16:
        return values[index]
    numbers = values.contiguous().view(torch.complex128)[:, 0]
    return numbers[index][..., None].view(values.dtype)
