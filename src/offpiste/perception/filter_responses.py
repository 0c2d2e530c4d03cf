"""Compiled loops for the backbone `filterbank`: patch means of colours and of responses to oriented filters.

They equal torch's operations up to rounding. Derivatives of a Gaussian in every direction are combined from separable
filters (Freeman and Adelson, "The Design and Use of Steerable Filters", PAMI 13, 1991).
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8

from offpiste.native.compilation import FILTER_SUMS, FILTERS

TAPS: Final = 7  # taps added at a time; lines are padded with zeros to a multiple

PRODUCTS: Final = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (0, 0), (3, 3))
"""Horizontal and vertical lines of `Derivatives` whose products are combined."""


class Derivatives(NamedTuple):
    """Derivatives of a Gaussian in several directions as sums of separable filters."""

    size: int  # number of taps, odd
    lines: Float32[np.ndarray, "4 taps"]  # g, x g, x^2 g, and ones, padded with zeros
    weights: Float32[np.ndarray, "k 7"]  # of the `PRODUCTS` in each filter


class PatchMeans(NamedTuple):
    """Patch means of the opponent planes, of their squares, and of the magnitudes of filter responses."""

    colours: Float32[np.ndarray, "3 rows columns"]
    squares: Float32[np.ndarray, "3 rows columns"]
    responses: Float32[np.ndarray, "k rows columns"]


def patch_means(
    pixels: UInt8[np.ndarray, "h w 3"],
    logarithm: Float32[np.ndarray, " 256"],
    fine: Derivatives,
    coarse: Sequence[Derivatives],
    patch: int,
) -> PatchMeans:
    """Compute the patch means of an image.

    Args:
        pixels: image whose sides are multiples of the patch.
        logarithm: of each value of a colour.
        fine: filters applied at every second pixel.
        coarse: filters of the image at half its size.
        patch: side of a patch, even [px].
    """
    height, width, _ = pixels.shape
    rows, columns = height // patch, width // patch
    near, far = fine.size // 2, max(filters.size for filters in coarse) // 2
    brightness = np.zeros((2, height + 2 * near, width // 2 + near + TAPS), np.float32)
    colours = np.zeros((2, 3, rows, columns), np.float32)
    put_colours(np.ascontiguousarray(pixels), logarithm, patch, near, brightness, colours)
    half = np.zeros((1, height // 2 + 2 * far, width // 2 + 2 * far + TAPS), np.float32)
    put_half(brightness, near, width // 2, far, half[0])
    responses = [_responses(brightness, near, fine, (rows, columns), patch // 2)]
    responses += [_responses(half, far, filters, (rows, columns), patch // 2) for filters in coarse]
    return PatchMeans(colours[0], colours[1], np.concatenate(responses))


def _responses(
    planes: Float32[np.ndarray, "p _ _"], margin: int, filters: Derivatives, shape: tuple[int, int], patch: int
) -> Float32[np.ndarray, "k rows columns"]:
    number, (lines, taps) = shape[1] * patch, filters.lines.shape
    across = np.zeros((taps, lines, number), np.float32)
    products = np.empty((len(PRODUCTS), number), np.float32)
    sums = np.empty((len(filters.weights), number), np.float32)
    means = np.empty((len(filters.weights), *shape), np.float32)
    put_responses(planes, margin - filters.size // 2, filters, patch, across, products, sums, means)
    return means


@FILTER_SUMS.entry
def put_colours(pixels, logarithm, patch, edge, brightness, means):  # type: ignore[no-untyped-def]
    """Write the brightness of an image, mirrored at its edges, and means of the opponent planes and their squares.

    Args:
        pixels: [h, w, 3].
        logarithm, patch: as in `patch_means`.
        edge: margin around the brightness [px].
        brightness: even, then odd columns, margin included [2, h + 2 edge, w / 2 + edge or more].
        means: zeros on input; of the planes and of their squares [2, 3, rows, columns].
    """
    height, width = pixels.shape[0], pixels.shape[1]
    for j in range(height):
        for column in range(width // patch):
            sums, squares = means[0, :, j // patch, column], means[1, :, j // patch, column]
            s0, s1, s2 = sums[0], sums[1], sums[2]
            q0, q1, q2 = squares[0], squares[1], squares[2]
            for i in range(column * patch, (column + 1) * patch):
                red, green, blue = logarithm[pixels[j, i, 0]], logarithm[pixels[j, i, 1]], logarithm[pixels[j, i, 2]]
                bright = (red + green + blue) / np.float32(3)
                apart, yellow = red - green, blue - (red + green) / np.float32(2)
                brightness[(edge + i) & 1, edge + j, (edge + i) >> 1] = bright
                s0, s1, s2 = s0 + bright, s1 + apart, s2 + yellow
                q0, q1, q2 = q0 + bright * bright, q1 + apart * apart, q2 + yellow * yellow
            sums[0], sums[1], sums[2] = s0, s1, s2
            squares[0], squares[1], squares[2] = q0, q1, q2
    divide(means, np.float32(patch * patch))
    for j in range(edge, edge + height):
        for k in range(1, edge + 1):
            low, high = edge - k, edge + width - 1 + k
            brightness[low & 1, j, low >> 1] = brightness[low & 1, j, (edge + k) >> 1]
            brightness[high & 1, j, high >> 1] = brightness[high & 1, j, (high - 2 * k) >> 1]
    mirror_lines(brightness[0], edge)
    mirror_lines(brightness[1], edge)


@FILTER_SUMS.loop
def divide(sums, number):  # type: ignore[no-untyped-def]
    """Divide sums in place."""
    for at in np.ndindex(sums.shape):
        sums[at] /= number


@FILTER_SUMS.loop
def mirror_lines(plane, edge):  # type: ignore[no-untyped-def]
    """Mirror a plane into the margin above and below it."""
    last = plane.shape[0] - edge - 1
    for k in range(1, edge + 1):
        for i in range(plane.shape[1]):
            plane[edge - k, i] = plane[edge + k, i]
            plane[last + k, i] = plane[last - k, i]


@FILTER_SUMS.entry
def put_half(brightness, edge, width, margin, half):  # type: ignore[no-untyped-def]
    """Write means of 2 x 2 pixels, mirrored at the edges.

    Args:
        brightness, edge: as in `put_colours`.
        width, margin: of the plane at half its size [px].
        half: [h / 2 + 2 margin, width + 2 margin or more].
    """
    for j in range(half.shape[0] - 2 * margin):
        upper, lower, out = edge + 2 * j, edge + 2 * j + 1, half[margin + j]
        left, right, begin, end = edge & 1, (edge + 1) & 1, edge >> 1, (edge + 1) >> 1
        for i in range(width):
            total = brightness[left, upper, begin + i] + brightness[right, upper, end + i]
            total = total + brightness[left, lower, begin + i] + brightness[right, lower, end + i]
            out[margin + i] = total / np.float32(4)
        for k in range(1, margin + 1):
            out[margin - k] = out[margin + k]
            out[margin + width - 1 + k] = out[margin + width - 1 - k]
    mirror_lines(half, margin)


@FILTERS.loop
def add_taps(x0, x1, x2, x3, x4, x5, x6, taps, line):  # type: ignore[no-untyped-def]
    """Add the products of `TAPS` taps to a line."""
    a0, a1, a2, a3, a4, a5, a6 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5], taps[6]
    for i in range(len(line)):
        a = line[i] + a0 * x0[i] + a1 * x1[i] + a2 * x2[i] + a3 * x3[i]
        line[i] = a + (a4 * x4[i] + a5 * x5[i] + a6 * x6[i])


@FILTERS.loop
def filter_across(planes, y, skip, lines, across):  # type: ignore[no-untyped-def]
    """Filter row y of the image horizontally with each of the lines [4, taps] into `across` [4, columns * patch]."""
    step, number = len(planes), across.shape[1]
    across[:] = np.float32(0)
    for tap in range(0, lines.shape[1], TAPS):
        t = skip + tap
        x0 = planes[t % step, y, t // step : t // step + number]
        x1 = planes[(t + 1) % step, y, (t + 1) // step : (t + 1) // step + number]
        x2 = planes[(t + 2) % step, y, (t + 2) // step : (t + 2) // step + number]
        x3 = planes[(t + 3) % step, y, (t + 3) // step : (t + 3) // step + number]
        x4 = planes[(t + 4) % step, y, (t + 4) // step : (t + 4) // step + number]
        x5 = planes[(t + 5) % step, y, (t + 5) // step : (t + 5) // step + number]
        x6 = planes[(t + 6) % step, y, (t + 6) // step : (t + 6) // step + number]
        for k in range(len(lines)):
            add_taps(x0, x1, x2, x3, x4, x5, x6, lines[k, tap : tap + TAPS], across[k])


@FILTERS.loop
def filter_down(across, y, of, taps, product):  # type: ignore[no-untyped-def]
    """Filter horizontally filtered rows vertically.

    Args:
        across: ring buffer of filtered rows, row y at y % taps [taps, 4, columns * patch].
        y: first row.
        of: number of the horizontal line.
        taps: of the vertical line [taps].
        product: output [columns * patch].
    """
    rows = len(across)
    product[:] = np.float32(0)
    for tap in range(0, len(taps), TAPS):
        first = y + tap
        x0, x1, x2 = across[first % rows, of], across[(first + 1) % rows, of], across[(first + 2) % rows, of]
        x3, x4, x5 = across[(first + 3) % rows, of], across[(first + 4) % rows, of], across[(first + 5) % rows, of]
        add_taps(x0, x1, x2, x3, x4, x5, across[(first + 6) % rows, of], taps[tap : tap + TAPS], product)


@FILTERS.loop
def add_magnitudes(p0, p1, p2, p3, p4, p5, p6, weights, line):  # type: ignore[no-untyped-def]
    """Add the magnitudes of the responses to a filter combined from products of lines."""
    w0, w1, w2, w3, w4, w5, w6 = weights[0], weights[1], weights[2], weights[3], weights[4], weights[5], weights[6]
    for i in range(len(line)):
        response = w0 * p0[i] + w1 * p1[i] + w2 * p2[i] + w3 * p3[i]
        line[i] += abs(response + (w4 * p4[i] + w5 * p5[i] + w6 * p6[i]))


@FILTERS.entry
def put_responses(planes, skip, filters, patch, across, products, sums, means):  # type: ignore[no-untyped-def]
    """Write patch means of the magnitudes of filter responses.

    Args:
        planes: an image, or its even and odd columns for responses at every second pixel.
        skip: rows and columns of the margin that no filter reaches.
        filters: `Derivatives`.
        patch: side of a patch [responses].
        across: zeros; ring buffer of filtered rows [taps, 4, columns * patch].
        products, sums: work arrays [7, columns * patch], [k, columns * patch].
        means: output [k, rows, columns].
    """
    step, rows, ready = len(planes), len(across), 0
    p0, p1, p2, p3 = products[0], products[1], products[2], products[3]
    p4, p5, p6 = products[4], products[5], products[6]
    for row in range(means.shape[1]):
        sums[:] = np.float32(0)
        for j in range(row * patch, (row + 1) * patch):
            first = step * j
            while ready < first + filters.size:
                filter_across(planes, skip + ready, skip, filters.lines, across[ready % rows])
                ready += 1
            for p in range(len(PRODUCTS)):
                filter_down(across, first, PRODUCTS[p][0], filters.lines[PRODUCTS[p][1]], products[p])
            for k in range(len(sums)):
                add_magnitudes(p0, p1, p2, p3, p4, p5, p6, filters.weights[k], sums[k])
        for k in range(len(sums)):
            for column in range(means.shape[2]):
                total = np.float32(0)
                for i in range(column * patch, (column + 1) * patch):
                    total += sums[k, i]
                means[k, row, column] = total / np.float32(patch * patch)
