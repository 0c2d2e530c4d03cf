"""Patch means of colours and of responses to oriented filters, for the backbone `filterbank`.

They equal torch's operations up to rounding. Derivatives of a Gaussian in every direction are combined from separable
filters (Freeman and Adelson, "The Design and Use of Steerable Filters", PAMI 13, 1991).
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from offpiste.native.library import compiled

PRODUCTS: Final = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (0, 0), (3, 3))
"""Horizontal and vertical lines of `Derivatives` whose products are combined."""
_OPPONENTS: Final = np.array([[1 / 3, 1 / 3, 1 / 3], [1, -1, 0], [-1 / 2, -1 / 2, 1]], np.float32)
"""Opponent planes of red, green and blue."""
_LANES: Final = 16
"""Largest number of responses that a processor computes at once."""
_MOST_TAPS: Final = 31


class Derivatives(NamedTuple):
    """Derivatives of a Gaussian in several directions as sums of separable filters."""

    lines: Float32[np.ndarray, "4 taps"]  # g, x g, x^2 g, and ones; an odd number of taps
    weights: Float32[np.ndarray, "k 7"]  # of the `PRODUCTS` in each filter


def patch_means(
    pixels: UInt8[np.ndarray, "h w 3"],
    logarithm: Float32[np.ndarray, " 256"],
    fine: Derivatives,
    coarse: Sequence[Derivatives],
    patch: int,
) -> tuple[Float32[np.ndarray, "_ rows columns"], ...]:
    """Return patch means of the opponent planes, of their squares, and of the magnitudes of filter responses.

    Args:
        pixels: image whose sides are multiples of the patch.
        logarithm: of each value of a colour.
        fine: filters applied at every second pixel.
        coarse: filters of the image at half its size.
        patch: side of a patch, even [px].
    """
    height, width, _ = pixels.shape
    planes = cv2.transform(cv2.LUT(pixels, logarithm), _OPPONENTS)
    # Images shrunk to whole fractions hold the means of the pixels.
    colours, squares = (
        np.moveaxis(cv2.resize(part, (width // patch, height // patch), interpolation=cv2.INTER_AREA), 2, 0)
        for part in (planes, planes * planes)
    )
    brightness = cv2.extractChannel(planes, 0)
    half = cv2.resize(brightness, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    responses = [mean_magnitudes(brightness, fine, patch // 2, step=2)]
    responses += [mean_magnitudes(half, filters, patch // 2) for filters in coarse]
    return colours, squares, np.concatenate(responses)


def mean_magnitudes(
    image: Float32[np.ndarray, "h w"], filters: Derivatives, patch: int, step: int = 1
) -> Float32[np.ndarray, "k rows columns"]:
    """Return patch means of the magnitudes of filter responses, with the image mirrored at its edges.

    Args:
        patch: side of a patch [responses].
        step: distance of responses, 1 or 2 [px].
    """
    (lines, weights), (_, taps) = filters, filters.lines.shape
    if (len(lines), weights.shape[1]) != (4, len(PRODUCTS)) or not taps % 2 or taps > _MOST_TAPS or step not in (1, 2):
        raise ValueError(f"unsupported filters: lines {lines.shape}, weights {weights.shape}, step {step} px")
    rows, columns = (length // (step * patch) for length in image.shape)
    number = -(-columns * patch // _LANES) * _LANES
    reach = taps // 2
    mirrored = cv2.copyMakeBorder(image, reach, reach, reach, reach + step * _LANES, cv2.BORDER_REFLECT_101)
    stride = mirrored.shape[1]
    work = np.empty((len(lines) * taps + len(weights)) * number + stride, np.float32)
    means = np.empty((len(weights), rows, columns), np.float32)
    put_responses(mirrored, stride, step, lines, taps, weights, len(weights), patch, rows, columns, number, work, means)
    return means


@compiled("f4", int, int, "f4", int, "f4", int, int, int, int, int, "f4", "f4")
def put_responses(  # type: ignore[no-untyped-def]
    image, stride, step, lines, taps, weights, filters, patch, rows, columns, number, work, means
):
    """Write patch means of the magnitudes of filter responses.

    Args:
        image: with a margin of `taps` // 2 above and left, and at least as much below and right [h, stride].
        step, lines, weights, patch: as in `mean_magnitudes` and `Derivatives`.
        number: `columns` * `patch`, rounded up to whole vectors.
        work: buffer of the compiled function.
        means: output [filters, rows, columns].
    """
    reach = taps // 2
    here = tuple(slice(reach, reach + step * patch * count, step) for count in (rows, columns))
    products = [cv2.sepFilter2D(image, -1, lines[across], lines[down])[here] for across, down in PRODUCTS]
    responses = np.abs(np.tensordot(weights, products, 1)).reshape(filters, rows, patch, columns, patch)
    means[:] = responses.mean(axis=(2, 4))
