"""Noise of ground textures: a function of the place in the world, in octaves from centimetres to metres.

Value noise (Ebert et al., Texturing and Modeling, 2003, ch. 2) reads one small table of random numbers. Each octave is
rotated by another angle to hide the period. Octaves finer than a pixel are left out, so that the same ground looks
different from near and far.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.native.compilation import RAYS

WAVELENGTHS: Final = 0.0125 * 2.0 ** np.arange(10)
"""Wavelengths of the octaves, 1.25 cm to 6.4 m [m]."""

PERIOD: Final = 128
"""Period of the table, a power of two."""

_WRAP, _NEXT = np.int32(PERIOD - 1), np.uint32(1)
_ZERO, _ONE, _TWO, _THREE, _SIX = np.float32(0), np.float32(1), np.float32(2), np.float32(3), np.float32(6)


def random_lattice(rng: np.random.Generator) -> Float[np.ndarray, "n n"]:
    """Periodic random numbers in [-1, 1], with the first row and column repeated at the end."""
    return np.pad(rng.uniform(-1, 1, (PERIOD, PERIOD)).astype(np.float32), ((0, 1), (0, 1)), mode="wrap")


def octave_turns(rng: np.random.Generator) -> Float[np.ndarray, "O 2"]:
    """Cosine and sine of each octave's angle, divided by its wavelength [1/m]."""
    angle = rng.uniform(0, 2 * np.pi, len(WAVELENGTHS))
    return (np.stack((np.cos(angle), np.sin(angle)), axis=1) / WAVELENGTHS[:, None]).astype(np.float32)


@RAYS.inlined
def hashed(i, j, seed):  # type: ignore[no-untyped-def]
    """Pseudorandom number in [0, 1) (after the finaliser of MurmurHash3)."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F) + np.uint64(seed)
    h = (h ^ (h >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xC4CEB9FE1A85EC53)
    return np.float32(h >> np.uint64(40)) * np.float32(1.0 / 16777216.0)


@RAYS.inlined
def value_noise(lattice, x, y):  # type: ignore[no-untyped-def]
    """Smooth noise of unit wavelength in [-1, 1], and its slopes."""
    low_x, low_y = np.floor(x), np.floor(y)
    i, j = np.int32(low_x) & _WRAP, np.int32(low_y) & _WRAP
    u, v = np.float32(x - low_x), np.float32(y - low_y)
    return blended(lattice[j, i], lattice[j, i + 1], lattice[j + 1, i], lattice[j + 1, i + 1], u, v)


@RAYS.inlined
def blended(corner, right, far, opposite, u, v):  # type: ignore[no-untyped-def]
    """Noise and its slopes at (u, v) in a cell with given values at its corners."""
    along_x, along_y = right - corner, far - corner
    twist = opposite - corner - along_x - along_y
    s, t = u * u * (_THREE - _TWO * u), v * v * (_THREE - _TWO * v)
    value = corner + along_x * s + (along_y + twist * s) * t
    slope_x = (along_x + twist * t) * (_SIX * u * (_ONE - u))
    slope_y = (along_y + twist * s) * (_SIX * v * (_ONE - v))
    return value, slope_x, slope_y


@RAYS.loop
def octaves(lattice, turn, sun, x, y, finest, cells, work, value, slope):  # type: ignore[no-untyped-def]
    """Noise of each octave at many places and its slope towards the sun, faded where a pixel cannot resolve it.

    Places are processed in batches, so that all but table look-ups run in vectors.

    Args:
        turn: `octave_turns`.
        sun: horizontal direction to the sun in each octave's lattice [O, 2].
        x, y: places in double precision [n] [m].
        finest: highest frequency that a pixel resolves (Nyquist) [n] [1/m].
        cells, work: integer and float buffers [2, >= n], [6, >= n].
        value, slope: results [O, >= n].
    """
    places, sharpest = len(x), _ZERO
    column, row, off_x, off_y = cells[0], cells[1], work[0], work[1]
    corner, right, far, opposite = work[2], work[3], work[4], work[5]
    for n in range(places):
        sharpest = max(sharpest, finest[n])
    for o in range(len(turn) - 1, -1, -1):
        cos, sin = turn[o, 0], turn[o, 1]
        wavelength = _ONE / np.sqrt(cos * cos + sin * sin)
        if sharpest * wavelength <= _ONE:
            for finer in range(o + 1):
                for n in range(places):
                    value[finer, n] = slope[finer, n] = 0
            break
        # Shift the lattices so that they share no origin.
        shift_x, shift_y = float(o * 17), float(o * 29)
        # LLVM does not vectorise loops over more arrays than these.
        for n in range(places):
            at = cos * x[n] + sin * y[n] + shift_x
            low = np.floor(at)
            off_x[n], column[n] = np.float32(at - low), np.int32(low) & _WRAP
        for n in range(places):
            at = cos * y[n] - sin * x[n] + shift_y
            low = np.floor(at)
            off_y[n], row[n] = np.float32(at - low), np.int32(low) & _WRAP
        for n in range(places):
            i, j = np.uint32(column[n]), np.uint32(row[n])
            corner[n], right[n] = lattice[j, i], lattice[j, i + _NEXT]
            far[n], opposite[n] = lattice[j + _NEXT, i], lattice[j + _NEXT, i + _NEXT]
        values, slopes, sun_x, sun_y = value[o], slope[o], sun[o, 0], sun[o, 1]
        for n in range(places):
            fade = min(max(finest[n] * wavelength - _ONE, _ZERO), _ONE)
            result, _, _ = blended(corner[n], right[n], far[n], opposite[n], off_x[n], off_y[n])
            values[n] = fade * result
        for n in range(places):
            fade = min(max(finest[n] * wavelength - _ONE, _ZERO), _ONE)
            _, slope_x, slope_y = blended(corner[n], right[n], far[n], opposite[n], off_x[n], off_y[n])
            slopes[n] = -fade * (slope_x * sun_x + slope_y * sun_y)


@RAYS.inlined
def pebbles(lattice, x, y):  # type: ignore[no-untyped-def]
    """Brightness of round stones about one unit apart (Worley noise, SIGGRAPH 1996, over four cells)."""
    low_x, low_y = np.floor(x - 0.5), np.floor(y - 0.5)
    nearest, tone = np.float32(9.0), np.float32(0.0)
    for n in range(4):
        cell_x, cell_y = low_x + (n & 1), low_y + (n >> 1)
        i, j = np.int32(cell_x) & _WRAP, np.int32(cell_y) & _WRAP
        off_x = np.float32(x - cell_x - 0.5) - np.float32(0.42) * lattice[j, i]
        off_y = np.float32(y - cell_y - 0.5) - np.float32(0.42) * lattice[i, j]
        distance = off_x * off_x + off_y * off_y
        if distance < nearest:
            nearest, tone = distance, lattice[(j + 64) & _WRAP, i]
    # Large stones are rarer than small ones; stones are brightest in the middle.
    size = np.float32(0.16) + np.float32(0.10) * tone
    return np.float32(0.5) * tone + np.float32(0.45) - nearest if nearest < size else np.float32(-0.3)
