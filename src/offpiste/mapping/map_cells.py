"""Which cells a place lies between, and what lies there: written once for torch, NumPy and compiled loops.

Plain arithmetic on numbers or arrays; loops compile it (`MAPPING.inlined(bilinear)`), the sampler calls it as it is.
Coordinates are in cells: cell [j, i] has its centre at x = i, y = j.
"""

from typing import Any

Number = Any
"""A float, a NumPy array or a tensor; constants are handed in so that float32 stays float32."""


def on_map(x: Number, y: Number, last_x: Number, last_y: Number, half: Number) -> Number:
    """Whether a place is nearest to one of the map's cells; false where it is not a number.

    Args:
        last_x, last_y: coordinates of the last column and row.
        half: 0.5.
    """
    return (x > -half) & (x < last_x + half) & (y > -half) & (y < last_y + half)


def bilinear(v00: Number, v01: Number, v10: Number, v11: Number, u: Number, v: Number, one: Number) -> Number:
    """Value between four cells, v[row][column]; NaN if one of them is.

    Args:
        u, v: from the first column and row, 0 to 1.
        one: 1.
    """
    return (v00 * (one - u) + v01 * u) * (one - v) + (v10 * (one - u) + v11 * u) * v
