"""Matrix primitives on rows of lanes; matrices are padded to multiples of four (`offpiste.dynamics.kernels.network`).

What is unrolled here by hand keeps sums in registers: about ten times as fast as plain loops (two rows of two AVX-512
vectors, four columns at a time).
"""

import numpy as np

from offpiste.dynamics.kernels.elementary import f4
from offpiste.dynamics.kernels.jit import lane_loop, lane_sum
from offpiste.dynamics.kernels.layout import LANES


@lane_loop
def copy(x: np.ndarray, y: np.ndarray) -> None:
    """As many numbers of x as fit into y."""
    for i in range(len(y)):
        y[i] = x[i]


@lane_loop
def add_product(w: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    """Add a product: y += W x.

    Args:
        w: [n, m], both multiples of four.
        x, y: [m * LANES], [n * LANES].
    """
    n, m = w.shape
    for q in range(0, n, 2):
        out = y[q * LANES : (q + 2) * LANES]
        for k in range(0, m, 4):
            a0, a1, a2, a3 = w[q, k], w[q, k + 1], w[q, k + 2], w[q, k + 3]
            b0, b1, b2, b3 = w[q + 1, k], w[q + 1, k + 1], w[q + 1, k + 2], w[q + 1, k + 3]
            rows = x[k * LANES : (k + 4) * LANES]
            for i in range(LANES):
                x0, x1, x2, x3 = rows[i], rows[LANES + i], rows[2 * LANES + i], rows[3 * LANES + i]
                out[i] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                out[LANES + i] += b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3


@lane_sum
def add_outer(g: np.ndarray, x: np.ndarray, w: np.ndarray) -> None:
    """Add an outer product: W += g x^T, summed over the lanes.

    Args:
        g, x: at least [n * LANES], [m * LANES].
        w: [n, m], m a multiple of four.
    """
    n, m = w.shape
    for q in range(n):
        row = g[q * LANES : (q + 1) * LANES]
        for k in range(0, m, 4):
            rows = x[k * LANES : (k + 4) * LANES]
            s0, s1, s2, s3 = f4(0), f4(0), f4(0), f4(0)
            for i in range(LANES):
                s0 += row[i] * rows[i]
                s1 += row[i] * rows[LANES + i]
                s2 += row[i] * rows[2 * LANES + i]
                s3 += row[i] * rows[3 * LANES + i]
            w[q, k] += s0
            w[q, k + 1] += s1
            w[q, k + 2] += s2
            w[q, k + 3] += s3
