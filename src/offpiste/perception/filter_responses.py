"""Colours and responses to oriented filters of an image of bytes, as means over patches: compiled loops.

They do what torch does for the backbone `filterbank`, its reference, in the same order: a sum is added term by term,
the products of a filter each with one rounding. That makes the same bits on x86-64, in a third of the time.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8

from offpiste.compilation import FILTER_SUMS, FILTERS

TAPS: Final = 7
"""Taps of a line that are added at a time; longer lines are filled up with zeros."""


class PatchMeans(NamedTuple):
    """Means over the patches of an image.

    Attributes:
        colours, squares: of the opponent planes, and of their squares.
        responses: of the magnitudes of the responses to each filter.
    """

    colours: Float32[np.ndarray, "3 rows columns"]
    squares: Float32[np.ndarray, "3 rows columns"]
    responses: Float32[np.ndarray, "k rows columns"]


def patch_means(
    pixels: UInt8[np.ndarray, "h w 3"],
    logarithm: Float32[np.ndarray, " 256"],
    fine: Float32[np.ndarray, "k s s"],
    coarse: Sequence[Float32[np.ndarray, "k _ _"]],
    patch: int,
) -> PatchMeans:
    """Measure an image.

    Args:
        pixels: whose sides are multiples of the patch.
        logarithm: of each value that a colour can have.
        fine: filters, an even number, that are applied at every second pixel.
        coarse: banks of filters of the image at half its size.
        patch: its side, an even number [px].
    """
    height, width, _ = pixels.shape
    rows, columns = height // patch, width // patch
    near, far = fine.shape[2] // 2, max(bank.shape[2] for bank in coarse) // 2
    brightness = np.zeros((2, height + 2 * near, width // 2 + near + TAPS), np.float32)
    colours = np.zeros((2, 3, rows, columns), np.float32)
    put_colours(np.ascontiguousarray(pixels), logarithm, patch, near, brightness, colours)
    half = np.zeros((1, height // 2 + 2 * far, width // 2 + 2 * far + TAPS), np.float32)
    put_half(brightness, near, width // 2, far, half[0])
    responses = [_responses(brightness, near, fine, (rows, columns), patch // 2)]
    responses += [_responses(half, far, bank, (rows, columns), patch // 2) for bank in coarse]
    return PatchMeans(colours[0], colours[1], np.concatenate(responses))


def _responses(
    planes: Float32[np.ndarray, "p _ _"],
    margin: int,
    bank: Float32[np.ndarray, "k s s"],
    shape: tuple[int, int],
    patch: int,
) -> Float32[np.ndarray, "k rows columns"]:
    size = bank.shape[2]
    filled = np.zeros((len(bank), size, -(-size // TAPS) * TAPS), np.float32)
    filled[:, :, :size] = bank
    lines, means = np.empty((len(bank), shape[1] * patch), np.float32), np.zeros((len(bank), *shape), np.float32)
    add_responses(planes, margin - size // 2, filled, patch, lines, means)
    return means


@FILTER_SUMS.entry
def put_colours(pixels, logarithm, patch, edge, brightness, means):  # type: ignore[no-untyped-def]
    """Put the brightness of an image, mirrored at its edges, and means of the opponent planes and their squares.

    Args:
        pixels: [h, w, 3].
        logarithm, patch: as in `patch_means`.
        edge: margin around the brightness [px].
        brightness: even columns, then odd ones, those of the margin counted [2, h + 2 edge, w / 2 + edge, or more].
        means: zeros, for the planes and for their squares [2, 3, rows, columns].
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
    """Turn sums into means."""
    for at in np.ndindex(sums.shape):
        sums[at] /= number


@FILTER_SUMS.loop
def mirror_lines(plane, edge):  # type: ignore[no-untyped-def]
    """Fill the margin above and below a plane with its mirror image."""
    last = plane.shape[0] - edge - 1
    for k in range(1, edge + 1):
        for i in range(plane.shape[1]):
            plane[edge - k, i] = plane[edge + k, i]
            plane[last + k, i] = plane[last - k, i]


@FILTER_SUMS.entry
def put_half(brightness, edge, width, margin, half):  # type: ignore[no-untyped-def]
    """Put means of four pixels each, mirrored at the edges.

    Args:
        brightness, edge: as in `put_colours`.
        width: of the plane at half its size [px].
        margin: around it [px].
        half: [h / 2 + 2 margin, width + 2 margin, or more].
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
def add_taps(x0, x1, x2, x3, x4, x5, x6, these, others, line, other_line):  # type: ignore[no-untyped-def]
    """Add the products of `TAPS` taps to the responses to two filters, tap after tap."""
    a0, a1, a2, a3, a4, a5, a6 = these[0], these[1], these[2], these[3], these[4], these[5], these[6]
    b0, b1, b2, b3, b4, b5, b6 = others[0], others[1], others[2], others[3], others[4], others[5], others[6]
    for i in range(len(line)):
        a = line[i] + a0 * x0[i]
        b = other_line[i] + b0 * x0[i]
        a, b = a + a1 * x1[i], b + b1 * x1[i]
        a, b = a + a2 * x2[i], b + b2 * x2[i]
        a, b = a + a3 * x3[i], b + b3 * x3[i]
        a, b = a + a4 * x4[i], b + b4 * x4[i]
        a, b = a + a5 * x5[i], b + b5 * x5[i]
        line[i], other_line[i] = a + a6 * x6[i], b + b6 * x6[i]


@FILTERS.entry
def add_responses(planes, skip, bank, patch, lines, means):  # type: ignore[no-untyped-def]
    """Put means of the magnitudes of responses.

    Args:
        planes: every column of an image, or the even columns and the odd ones; then every second pixel responds.
        skip: lines and columns of the margin that no filter reaches.
        bank: filters, filled up to a multiple of `TAPS` with zeros [k, s, s, or more].
        patch: its side [responses].
        lines: room [k, columns * patch].
        means: zeros [k, rows, columns].
    """
    step, number = len(planes), lines.shape[1]
    for j in range(means.shape[1] * patch):
        lines[:] = np.float32(0)
        for down in range(bank.shape[1]):
            y = skip + step * j + down
            for tap in range(0, bank.shape[2], TAPS):
                t, these = skip + tap, slice(tap, tap + TAPS)
                x0 = planes[t % step, y, t // step : t // step + number]
                x1 = planes[(t + 1) % step, y, (t + 1) // step : (t + 1) // step + number]
                x2 = planes[(t + 2) % step, y, (t + 2) // step : (t + 2) // step + number]
                x3 = planes[(t + 3) % step, y, (t + 3) // step : (t + 3) // step + number]
                x4 = planes[(t + 4) % step, y, (t + 4) // step : (t + 4) // step + number]
                x5 = planes[(t + 5) % step, y, (t + 5) // step : (t + 5) // step + number]
                x6 = planes[(t + 6) % step, y, (t + 6) // step : (t + 6) // step + number]
                for k in range(0, len(bank), 2):
                    one, other = bank[k, down, these], bank[k + 1, down, these]
                    add_taps(x0, x1, x2, x3, x4, x5, x6, one, other, lines[k], lines[k + 1])
        for k in range(len(bank)):
            line, into = lines[k], means[k, j // patch]
            for column in range(len(into)):
                total = into[column]
                for i in range(column * patch, (column + 1) * patch):
                    total += abs(line[i])
                into[column] = total
    divide(means, np.float32(patch * patch))
