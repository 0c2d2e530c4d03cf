"""Noise that ground is drawn with: a function of the place in the world, in octaves from centimetres to metres.

Value noise (Ebert et al., Texturing and Modeling, 2003, ch. 2) reads one small table of random numbers, each octave
turned by another angle, so that its period does not show. Octaves finer than a pixel are left out: near and far images
of the same ground differ as real ones do.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.compilation import RAYS

WAVELENGTHS: Final = 0.0125 * 2.0 ** np.arange(10)
"""Wavelengths of the octaves, 1.25 cm to 6.4 m [m]."""

PERIOD: Final = 128
"""Period of the table, a power of two."""

_WRAP = np.int32(PERIOD - 1)
_ONE, _TWO, _THREE, _SIX = np.float32(1), np.float32(2), np.float32(3), np.float32(6)


def random_lattice(rng: np.random.Generator) -> Float[np.ndarray, "n n"]:
    """Random numbers in [-1, 1], periodic; the first row and column are repeated at the end."""
    return np.pad(rng.uniform(-1, 1, (PERIOD, PERIOD)).astype(np.float32), ((0, 1), (0, 1)), mode="wrap")


def octave_turns(rng: np.random.Generator) -> Float[np.ndarray, "O 2"]:
    """Cosine and sine of each octave's angle, over its wavelength [1/m]."""
    angle = rng.uniform(0, 2 * np.pi, len(WAVELENGTHS))
    return (np.stack((np.cos(angle), np.sin(angle)), axis=1) / WAVELENGTHS[:, None]).astype(np.float32)


@RAYS.inlined
def hashed(i, j, seed):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that looks random (after the finaliser of MurmurHash3)."""
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
    corner = lattice[j, i]
    along_x, along_y = lattice[j, i + 1] - corner, lattice[j + 1, i] - corner
    twist = lattice[j + 1, i + 1] - corner - along_x - along_y
    s, t = u * u * (_THREE - _TWO * u), v * v * (_THREE - _TWO * v)
    value = corner + along_x * s + (along_y + twist * s) * t
    slope_x = (along_x + twist * t) * (_SIX * u * (_ONE - u))
    slope_y = (along_y + twist * s) * (_SIX * v * (_ONE - v))
    return value, slope_x, slope_y


@RAYS.inlined
def octaves(lattice, turn, sun, x, y, footprint, value, slope):  # type: ignore[no-untyped-def]
    """Noise of each octave, faded where a pixel is too large for it (Nyquist), and how much it faces the sun.

    Args:
        turn: `octave_turns`.
        sun: horizontal direction to the sun in each octave's lattice [O, 2].
        footprint: size of a pixel on the ground [m].
        value, slope: [O], overwritten.
    """
    finest = _ONE / (_TWO * np.float32(footprint))
    for o in range(len(turn) - 1, -1, -1):
        cos, sin = turn[o, 0], turn[o, 1]
        fade = min(finest / np.sqrt(cos * cos + sin * sin) - _ONE, _ONE)
        if fade <= 0:
            for finer in range(o + 1):
                value[finer] = slope[finer] = 0.0
            break
        # Lattices are shifted against each other: no place in the world is the origin of all.
        result, slope_x, slope_y = value_noise(lattice, cos * x + sin * y + o * 17, cos * y - sin * x + o * 29)
        value[o] = fade * result
        slope[o] = -fade * (slope_x * sun[o, 0] + slope_y * sun[o, 1])


@RAYS.inlined
def pebbles(lattice, x, y):  # type: ignore[no-untyped-def]
    """Brightness of round stones about one unit apart, dark between them (Worley, SIGGRAPH 1996; four cells)."""
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
    # Large stones are rarer than small ones; round ones are brightest in the middle.
    size = np.float32(0.16) + np.float32(0.10) * tone
    return np.float32(0.5) * tone + np.float32(0.45) - nearest if nearest < size else np.float32(-0.3)
