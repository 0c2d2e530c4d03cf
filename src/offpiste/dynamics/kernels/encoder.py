"""Codes of terrain features by a kernel, with gradients: cells in, codes out, nothing kept in between.

A block of cells is standardised and goes through both hidden layers while it lies in the processor's cache. The adjoint
computes them again, which is cheaper than to keep them.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import pad

from offpiste.dynamics.feature_encoder import Compressor, FeatureEncoder
from offpiste.dynamics.kernels.coverage import uncovered_encoder
from offpiste.dynamics.kernels.elementary import Lane, f4, matrix_products, tanh
from offpiste.native.compilation import KERNELS, spread_kernel

CELLS = 128
"""Cells that go through the layers side by side."""

CHUNK = 8
"""Blocks whose gradients are summed before those of others, so that sums do not depend on the number of threads."""

_add_product, _add_outer = matrix_products(CELLS)


class Layers(NamedTuple):
    """What the kernel reads of an encoder.

    Attributes:
        mean, inverse_scale: of the features [F].
        first, second, last: weights with their biases as columns, padded to multiples of four: on (features, flag, 1,
            padding), on (hidden layer, 1, padding) and on (hidden layer, 1, padding).
        second_t, last_t: transposes.
    """

    mean: np.ndarray
    inverse_scale: np.ndarray
    first: np.ndarray
    second: np.ndarray
    last: np.ndarray
    second_t: np.ndarray
    last_t: np.ndarray


def supports_encoder(encoder: FeatureEncoder, features: Tensor) -> bool:
    """Whether `encode_cells` can compute these codes: of a `Compressor`, on the CPU, in float32, of recorded cells."""
    if not isinstance(encoder, Compressor) or uncovered_encoder(encoder) or features.requires_grad:
        return False
    tensors = (features, *encoder.parameters())
    return all(tensor.device.type == "cpu" and tensor.dtype == torch.float32 for tensor in tensors)


def encode_cells(
    encoder: Compressor, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]
) -> Float[Tensor, "M E"]:
    """`encoder(features, valid)`, several times as fast; gradients reach the encoder's weights."""
    matrices = _matrices(encoder)
    given = features.contiguous().numpy(), valid.contiguous().numpy(), _layers(encoder, matrices)
    return _Encode.apply(given, encoder.size, *matrices)  # type: ignore[no-untyped-call, no-any-return]


def _matrices(encoder: Compressor) -> list[Tensor]:
    """Weights of its layers with their biases as columns, differentiable."""
    return [_padded(layer) for layer in encoder.layers.children() if isinstance(layer, nn.Linear)]


def _layers(encoder: Compressor, matrices: Sequence[Tensor]) -> Layers:
    first, second, last = (matrix.detach().contiguous() for matrix in matrices)
    return Layers(
        encoder.mean.numpy(),
        (1 / encoder.scale).numpy(),
        *(matrix.numpy() for matrix in (first, second, last)),
        *(matrix.t().contiguous().numpy() for matrix in (second, last)),
    )


def layers_of(encoder: FeatureEncoder | None) -> Layers:
    """What kernels read of any encoder: matrices are empty where features are codes, and all is where there is none."""
    if isinstance(encoder, Compressor):
        return _layers(encoder, _matrices(encoder))
    mean = np.zeros(0, np.float32) if encoder is None else encoder.mean.numpy()
    return Layers(mean, np.ones_like(mean), *(np.zeros((0, 0), np.float32) for _ in range(5)))


def _padded(layer: nn.Linear) -> Float[Tensor, "N M"]:
    matrix = torch.cat((layer.weight, layer.bias[:, None]), dim=1)
    return pad(matrix, (0, -matrix.shape[1] % 4, 0, -matrix.shape[0] % 4))


class _Encode(torch.autograd.Function):
    """The kernels as one operation of autograd."""

    @staticmethod
    def forward(ctx: Any, given: tuple[np.ndarray, np.ndarray, Layers], size: int, *matrices: Tensor) -> Tensor:
        """Codes [M, E]; `matrices`, which the layers were made of, tie them to the graph."""
        codes = torch.empty(len(given[0]), size, dtype=torch.float32)
        ctx.given = given
        spread_kernel(_chunks(len(codes)), encode_forward, *given, codes.numpy())
        return codes

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bar: Tensor) -> tuple[Tensor | None, ...]:
        """Adjoints of the matrices."""
        layers, chunks = ctx.given[2], _chunks(len(bar))
        by_chunk = [np.zeros((chunks, *m.shape), np.float32) for m in (layers.first, layers.second, layers.last)]
        spread_kernel(chunks, encode_backward, *ctx.given, bar.contiguous().numpy(), *by_chunk)
        return None, None, *(torch.from_numpy(adjoint.sum(axis=0)) for adjoint in by_chunk)


def codes_under_wheels(codes: Float[Tensor, "M E"], cells: Int[Tensor, "*S"]) -> Float[Tensor, "*S E"]:
    """`codes[cells]`, whose gradient is summed in the order of `cells`; codes are float32 on the CPU."""
    return _Take.apply(codes, cells)  # type: ignore[no-untyped-call, no-any-return]


class _Take(torch.autograd.Function):
    """Codes of cells, and the sum of their adjoints by cell."""

    @staticmethod
    def forward(ctx: Any, codes: Tensor, cells: Tensor) -> Tensor:
        """Codes [*S, E]."""
        ctx.cells, ctx.count = cells, len(codes)
        return codes.index_select(0, cells.flatten()).view(*cells.shape, codes.shape[1])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bar: Tensor) -> tuple[Tensor, None]:
        """Adjoint of the codes."""
        codes_bar = np.zeros((ctx.count, bar.shape[-1]), np.float32)
        cells = ctx.cells.flatten()
        add_by_cell(bar.reshape(len(cells), bar.shape[-1]).contiguous().numpy(), cells.numpy(), codes_bar)
        return torch.from_numpy(codes_bar), None


@KERNELS.entry
def add_by_cell(bar: np.ndarray, cells: np.ndarray, codes_bar: np.ndarray) -> None:
    """Add rows [N, E] to those [M, E] that `cells` [N] names."""
    for row in range(len(cells)):
        cell = cells[row]
        for k in range(bar.shape[1]):
            codes_bar[cell, k] += bar[row, k]


def _chunks(cells: int) -> int:
    return -(-cells // (CHUNK * CELLS))


class Activations(NamedTuple):
    """Rows of a block of cells.

    Attributes:
        seen: standardised features, flag, 1, padding.
        inner, outer: the hidden layers, each with 1 and padding.
        code: the result, with padding.
    """

    seen: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    code: np.ndarray


@KERNELS.maker
def make_activations(layers: Layers, one: Lane) -> Activations:
    """Empty rows; `one` stands where biases read it, 0 for adjoints."""
    seen = np.zeros(layers.first.shape[1] * CELLS, f4)
    inner = np.zeros(layers.second.shape[1] * CELLS, f4)
    outer = np.zeros(layers.last.shape[1] * CELLS, f4)
    features, width, last = len(layers.mean) + 1, layers.first.shape[0], layers.second.shape[0]
    seen[features * CELLS : (features + 1) * CELLS] = one
    inner[width * CELLS : (width + 1) * CELLS] = one
    outer[last * CELLS : (last + 1) * CELLS] = one
    return Activations(seen, inner, outer, np.zeros(layers.last.shape[0] * CELLS, f4))


@KERNELS.loop
def encode_block(a: Activations, features: np.ndarray, valid: np.ndarray, layers: Layers, block: int) -> None:
    """A block of cells through all layers; lanes behind the last cell repeat it."""
    last, channels = len(features) - 1, len(layers.mean)
    for i in range(CELLS):
        cell = min(block * CELLS + i, last)
        if valid[cell]:
            for k in range(channels):
                a.seen[k * CELLS + i] = (features[cell, k] - layers.mean[k]) * layers.inverse_scale[k]
        else:
            for k in range(channels):
                a.seen[k * CELLS + i] = f4(0)
        a.seen[channels * CELLS + i] = f4(-1) if valid[cell] else f4(1)
    width = layers.first.shape[0] * CELLS
    a.inner[:width] = f4(0)
    _add_product(layers.first, a.seen, a.inner)
    for i in range(width):
        a.inner[i] = tanh(a.inner[i])
    width = layers.second.shape[0] * CELLS
    a.outer[:width] = f4(0)
    _add_product(layers.second, a.inner, a.outer)
    for i in range(width):
        a.outer[i] = tanh(a.outer[i])
    a.code[:] = f4(0)
    _add_product(layers.last, a.outer, a.code)


@KERNELS.entry
def encode_forward(
    first: int, last: int, features: np.ndarray, valid: np.ndarray, layers: Layers, codes: np.ndarray
) -> None:
    """Codes of the cells of chunks `first` ... `last - 1`.

    Args:
        features, valid: of the cells [M, F], [M].
        layers: see `Layers`.
        codes: to fill [M, E].
    """
    a = make_activations(layers, f4(1))
    for block in range(first * CHUNK, min(last * CHUNK, -(-len(codes) // CELLS))):
        encode_block(a, features, valid, layers, block)
        for i in range(min(CELLS, len(codes) - block * CELLS)):
            for k in range(codes.shape[1]):
                codes[block * CELLS + i, k] = a.code[k * CELLS + i]


@KERNELS.entry
def encode_backward(
    first: int,
    last: int,
    features: np.ndarray,
    valid: np.ndarray,
    layers: Layers,
    codes_bar: np.ndarray,
    first_bar: np.ndarray,
    second_bar: np.ndarray,
    last_bar: np.ndarray,
) -> None:
    """Back through `encode_forward`.

    Args:
        first, last, features, valid, layers: as there.
        codes_bar: adjoint of the result.
        first_bar, second_bar, last_bar: adjoints of the layers' weights by chunk, zero, to add to.
    """
    a, bar = make_activations(layers, f4(1)), make_activations(layers, f4(0))
    for block in range(first * CHUNK, min(last * CHUNK, -(-len(codes_bar) // CELLS))):
        chunk, inside = block // CHUNK, min(CELLS, len(codes_bar) - block * CELLS)
        encode_block(a, features, valid, layers, block)
        bar.code[:] = f4(0)
        for i in range(inside):
            for k in range(codes_bar.shape[1]):
                bar.code[k * CELLS + i] = codes_bar[block * CELLS + i, k]
        _add_outer(bar.code, a.outer, last_bar[chunk])
        bar.outer[:] = f4(0)
        _add_product(layers.last_t, bar.code, bar.outer)
        for i in range(layers.second.shape[0] * CELLS):
            bar.outer[i] *= f4(1) - a.outer[i] * a.outer[i]
        _add_outer(bar.outer, a.inner, second_bar[chunk])
        bar.inner[:] = f4(0)
        _add_product(layers.second_t, bar.outer, bar.inner)
        for i in range(layers.first.shape[0] * CELLS):
            bar.inner[i] *= f4(1) - a.inner[i] * a.inner[i]
        _add_outer(bar.inner, a.seen, first_bar[chunk])
