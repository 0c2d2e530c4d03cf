"""Elementary functions of one float32 lane, and matrix products on a block of them.

The functions are polynomials without branches, so that loops over lanes become vector code.
Largest errors, against float64 (tests/dynamics/kernels/test_elementary.py): see each function. NaN gives NaN.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.vectors import WIDTH, load, store
from offpiste.native.compilation import KERNELS

f4 = np.float32

Lane = Any
"""One float32."""

# pi in parts; the first three have few bits, so that their products with whole numbers below 2^13 are exact.
_PI_0, _PI_1, _PI_2, _PI_3 = f4(3.140625), f4(9.670257568359375e-4), f4(6.277114152908325e-7), f4(1.215420125655342e-10)
_INVERSE_PI = f4(1 / np.pi)
_HALF_PI = f4(np.pi / 2)


@KERNELS.inlined
def _sin_less_multiples_of_pi(x: Lane, n: Lane) -> Lane:
    """sin(x - n pi), for |x - n pi| <= pi/2; what rounding puts outside, for huge x, counts as pi/2."""
    x = (((x - n * _PI_0) - n * _PI_1) - n * _PI_2) - n * _PI_3
    x = _HALF_PI if x > _HALF_PI else x
    x = -_HALF_PI if x < -_HALF_PI else x
    s = x * x
    p = f4(-2.3889859e-8)
    p = p * s + f4(2.7525562e-6)
    p = p * s + f4(-1.9840874e-4)
    p = p * s + f4(8.3333310e-3)
    p = p * s + f4(-1.6666667e-1)
    return x + x * s * p


@KERNELS.inlined
def sin(x: Lane) -> Lane:
    """Sine; absolute error < 3e-7 for |x| < 1e4."""
    n = np.floor(x * _INVERSE_PI + f4(0.5))
    sign = f4(1) - f4(2) * (n - f4(2) * np.floor(n * f4(0.5)))
    return sign * _sin_less_multiples_of_pi(x, n)


@KERNELS.inlined
def cos(x: Lane) -> Lane:
    """Cosine; absolute error < 3e-7 for |x| < 1e4."""
    n = np.floor(x * _INVERSE_PI)
    sign = f4(2) * (n - f4(2) * np.floor(n * f4(0.5))) - f4(1)
    return sign * _sin_less_multiples_of_pi(x, n + f4(0.5))


@KERNELS.inlined
def tanh(x: Lane) -> Lane:
    """Hyperbolic tangent; absolute and relative error < 4e-7 everywhere.

    The rational approximation that Eigen uses.
    """
    limit = f4(7.905311)
    x = limit if x > limit else x
    x = -limit if x < -limit else x
    s = x * x
    p = f4(-2.76076847742355e-16)
    p = p * s + f4(2.00018790482477e-13)
    p = p * s + f4(-8.60467152213735e-11)
    p = p * s + f4(5.12229709037114e-08)
    p = p * s + f4(1.48572235717979e-05)
    p = p * s + f4(6.37261928875436e-04)
    p = p * s + f4(4.89352455891786e-03)
    q = f4(1.19825839466702e-06)
    q = q * s + f4(1.18534705686654e-04)
    q = q * s + f4(2.26843463243900e-03)
    q = q * s + f4(4.89352518554385e-03)
    return x * p / q


@KERNELS.inlined
def atan(x: Lane) -> Lane:
    """Inverse tangent; absolute and relative error < 3e-7 everywhere.

    Cephes' atanf: in three intervals of |x| around 0, 1 and infinity.
    """
    a = abs(x)
    far, near = a > f4(2.414213562373095), a <= f4(0.4142135623730950)
    over = f4(-1) if far else (a if near else a - f4(1))
    under = a if far else (f4(1) if near else a + f4(1))
    offset = f4(np.pi / 2) if far else (f4(0) if near else f4(np.pi / 4))
    z = over / under
    s = z * z
    p = f4(8.05374449538e-2)
    p = p * s + f4(-1.38776856032e-1)
    p = p * s + f4(1.99777106478e-1)
    p = p * s + f4(-3.33329491539e-1)
    y = offset + (p * s * z + z)
    return -y if x < f4(0) else y


@KERNELS.inlined
def maximum(a: Lane, b: Lane) -> Lane:
    """The larger one."""
    return a if a > b else b


@KERNELS.inlined
def step(a: Lane, b: Lane) -> Lane:
    """Derivative of `maximum(a, b)` by a: 1, 0, or 1/2 where both are equal, as autograd has it."""
    return f4(1) if a > b else (f4(0.5) if a == b else f4(0))


@KERNELS.inlined
def copy(x: np.ndarray, y: np.ndarray) -> None:
    """As many numbers of x as fit into y."""
    for i in range(len(y)):
        y[i] = x[i]


@KERNELS.inlined
def copy_or_zero(x: np.ndarray, y: np.ndarray) -> None:
    """As many numbers of x as fit into y, or 0 where x has none."""
    if len(x) > 0:
        copy(x, y)
    else:
        y[:] = f4(0)


class MatrixProducts(NamedTuple):
    """Products of small matrices with blocks of lanes: y += W x, and W += g x^T summed over the lanes."""

    add_product: Callable[[np.ndarray, np.ndarray, np.ndarray], None]
    add_outer: Callable[[np.ndarray, np.ndarray, np.ndarray], None]


def matrix_products(lanes: int) -> MatrixProducts:
    """Products for blocks of so many lanes."""

    @KERNELS.loop
    def add_product(w: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        """Add a product: y += W x; sums of four rows stay in registers.

        Args:
            w: [n, m], n a multiple of four.
            x, y: [m * lanes], [n * lanes].
        """
        n, m = w.shape
        for q in range(0, n, 4):
            for i in range(0, lanes, WIDTH):
                row = q * lanes + i
                a, b = load(y, row), load(y, row + lanes)
                c, d = load(y, row + 2 * lanes), load(y, row + 3 * lanes)
                for k in range(m):
                    column = load(x, k * lanes + i)
                    a += w[q, k] * column
                    b += w[q + 1, k] * column
                    c += w[q + 2, k] * column
                    d += w[q + 3, k] * column
                store(y, row, a)
                store(y, row + lanes, b)
                store(y, row + 2 * lanes, c)
                store(y, row + 3 * lanes, d)

    @KERNELS.summing_loop
    def add_outer(g: np.ndarray, x: np.ndarray, w: np.ndarray) -> None:
        """Add an outer product: W += g x^T, summed over the lanes; two rows at a time, so that x is read half as often.

        Args:
            g, x: at least [n * lanes], [m * lanes].
            w: [n, m], both multiples of four.
        """
        n, m = w.shape
        for q in range(0, n, 2):
            both = g[q * lanes : (q + 2) * lanes]
            for k in range(0, m, 4):
                rows = x[k * lanes : (k + 4) * lanes]
                a0, a1, a2, a3, b0, b1, b2, b3 = f4(0), f4(0), f4(0), f4(0), f4(0), f4(0), f4(0), f4(0)
                for i in range(lanes):
                    x0, x1, x2, x3 = rows[i], rows[lanes + i], rows[2 * lanes + i], rows[3 * lanes + i]
                    a0 += both[i] * x0
                    a1 += both[i] * x1
                    a2 += both[i] * x2
                    a3 += both[i] * x3
                    b0 += both[lanes + i] * x0
                    b1 += both[lanes + i] * x1
                    b2 += both[lanes + i] * x2
                    b3 += both[lanes + i] * x3
                w[q, k] += a0
                w[q, k + 1] += a1
                w[q, k + 2] += a2
                w[q, k + 3] += a3
                w[q + 1, k] += b0
                w[q + 1, k + 1] += b1
                w[q + 1, k + 2] += b2
                w[q + 1, k + 3] += b3

    return MatrixProducts(add_product, add_outer)


add_product, add_outer = matrix_products(LANES)
