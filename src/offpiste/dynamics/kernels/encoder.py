"""Differentiable encoder of terrain features in the compiled library.

No activations are stored: the backward pass recomputes the hidden layers, which is cheaper than storing them.
"""

from collections.abc import Sequence
from ctypes import Structure, c_int, c_void_p
from typing import Any, Final

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from offpiste.dynamics.feature_encoder import Compressor, FeatureEncoder
from offpiste.dynamics.kernels.coverage import uncovered_encoder
from offpiste.dynamics.kernels.networks import linear_layers, widened, with_bias
from offpiste.native.library import library
from offpiste.native.tensors import Arrays, call, new_floats

CELLS: Final = 1024
"""Cells whose gradients are summed before those of others (`native/cpp/encoder.h`)."""


class Encoder(Structure):
    """An encoder as the library reads it, with the arrays that its addresses point to."""

    _fields_ = (
        *((name, c_int) for name in ("features", "first", "second", "size", "padded")),
        *((name, c_void_p) for name in ("mean", "inverse_scale", "first_layer", "second_layer", "last_layer")),
    )
    arrays: Arrays


class _Cells(Structure):
    _fields_ = (("count", c_int), ("stride", c_int), ("features", c_void_p), ("valid", c_void_p))


def supports_encoder(encoder: FeatureEncoder, features: Tensor) -> bool:
    """Return whether `encode_cells` computes these codes: of a `Compressor` for recorded cells, float32 on the CPU."""
    if not isinstance(encoder, Compressor) or uncovered_encoder(encoder) or features.requires_grad or not library():
        return False
    if features.shape[-1] < len(encoder.mean):
        return False
    tensors = (features, *encoder.parameters())
    return all(tensor.device.type == "cpu" and tensor.dtype == torch.float32 for tensor in tensors)


def encode_cells(
    encoder: Compressor, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]
) -> Float[Tensor, "M E"]:
    """Evaluate `encoder(features, valid)` with the compiled library, several times as fast.

    Differentiable with respect to the encoder's weights.
    """
    matrices = _matrices(encoder)
    return _Encode.apply(encoder_of(encoder, matrices), features, valid, *matrices)  # type: ignore[no-untyped-call, no-any-return]


def codes_by_cell(
    encoder: FeatureEncoder, features: Float[Tensor, "M F"], valid: Bool[Tensor, " M"]
) -> Float[Tensor, "M E"]:
    """Return the codes of cells, by the compiled library if it supports the encoder."""
    if isinstance(encoder, Compressor) and supports_encoder(encoder, features):
        return encode_cells(encoder, features, valid)
    codes: Tensor = encoder(features, valid)
    return codes


def encoder_of(encoder: FeatureEncoder | None, matrices: Sequence[Tensor] | None = None) -> Encoder:
    """Return an encoder as the library reads it; without an encoder, a structure with zero features."""
    mean = torch.zeros(0) if encoder is None else encoder.mean
    arrays = Arrays()
    result = Encoder(features=len(mean), size=0 if encoder is None else encoder.size, mean=arrays.floats(mean))
    result.arrays = arrays
    if isinstance(encoder, Compressor):
        layers = _matrices(encoder) if matrices is None else matrices
        result.first, result.second, result.padded = (layer.shape[1] for layer in layers)
        result.inverse_scale = arrays.floats(1 / encoder.scale)
        result.first_layer, result.second_layer, result.last_layer = map(arrays.floats, layers)
    return result


def _matrices(encoder: Compressor) -> list[Tensor]:
    """Return the layers input by input with their biases as last rows, differentiable."""
    return [widened(with_bias(layer)) for layer in linear_layers(encoder.layers)]


class _Encode(torch.autograd.Function):
    """Entries `encode` and `encode_back` as one operation of autograd."""

    @staticmethod
    def forward(ctx: Any, encoder: Encoder, features: Tensor, valid: Tensor, *matrices: Tensor) -> Tensor:
        """Return codes [M, E]; `matrices`, which the encoder was made of, tie them to the graph."""
        arrays = Arrays()
        cells = _Cells(len(features), features.shape[1], arrays.floats(features), arrays.bytes(valid))
        codes = new_floats(len(features), encoder.size)
        call("encode", -(-len(features) // CELLS), encoder, cells, codes)
        ctx.encoder, ctx.cells, ctx.arrays, ctx.shapes = encoder, cells, arrays, [m.shape for m in matrices]
        return codes

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, bar: Tensor) -> tuple[Tensor | None, ...]:
        """Return the adjoints of the matrices."""
        chunks = -(-len(bar) // CELLS)
        by_chunk = [new_floats(chunks, *shape) for shape in ctx.shapes]
        call("encode_back", chunks, ctx.encoder, ctx.cells, bar.contiguous(), *by_chunk)
        return None, None, None, *(adjoint.sum(dim=0) for adjoint in by_chunk)
