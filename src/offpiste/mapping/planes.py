"""Least-squares planes through what was hit around each cell, by moving sums: z over x, y, each hit where it was.

Rows are summed over the window's columns, then over its rows; coordinates are always relative to the window's centre,
so that float32 is enough. Every inner loop writes one row only: with more, LLVM does not turn it into vectors.
"""

from typing import Final

import numpy as np

from offpiste.mapping.compiled import map_loop, row_loop

N, SX, SY, SZ, SXX, SXY, SYY, SXZ, SYZ = range(9)
"""Sums over a window's points: their number, x, y, z and products."""

SUMS: Final = 9

MIN_SPREAD: Final = 0.2
"""Least variance of a window's points in any direction for a plane [cells^2]: two full lines of cells side by side
have 0.25 or more, a single one about 0.08."""


@row_loop
def put_product(a, b, out):  # type: ignore[no-untyped-def]
    """Put a b."""
    for i in range(len(out)):
        out[i] = a[i] * b[i]


@row_loop
def put_moments(x, y, z, out):  # type: ignore[no-untyped-def]
    """What each cell of a row adds to the sums of its own window."""
    count, px, py, pz = out[N], out[SX], out[SY], out[SZ]
    for i in range(len(z)):
        count[i] = np.float32(1) if z[i] == z[i] else np.float32(0)
    for i in range(len(z)):
        px[i] = x[i] if z[i] == z[i] else np.float32(0)
    for i in range(len(z)):
        py[i] = y[i] if z[i] == z[i] else np.float32(0)
    for i in range(len(z)):
        pz[i] = z[i] if z[i] == z[i] else np.float32(0)
    put_product(px, px, out[SXX])
    put_product(px, py, out[SXY])
    put_product(py, py, out[SYY])
    put_product(px, pz, out[SXZ])
    put_product(py, pz, out[SYZ])


@row_loop
def add(out, a):  # type: ignore[no-untyped-def]
    """Add a."""
    for i in range(len(out)):
        out[i] += a[i]


@row_loop
def add_shifted(out, a, b, shift):  # type: ignore[no-untyped-def]
    """Add a + shift b."""
    for i in range(len(out)):
        out[i] += a[i] + shift * b[i]


@row_loop
def add_twice_shifted(out, a, b, c, shift):  # type: ignore[no-untyped-def]
    """Add a + 2 shift b + shift^2 c."""
    twice, squared = shift + shift, shift * shift
    for i in range(len(out)):
        out[i] += a[i] + twice * b[i] + squared * c[i]


@row_loop
def add_columns(moments, k, out):  # type: ignore[no-untyped-def]
    """Add to each cell's sums what the cell `k` columns further on has."""
    n, shift = out.shape[1], np.float32(k)
    to, at = slice(max(0, -k), min(n, n - k)), slice(max(0, k), min(n, n + k))
    count, px, pz = moments[N, at], moments[SX, at], moments[SZ, at]
    add(out[N, to], count)
    add_shifted(out[SX, to], px, count, shift)
    add(out[SY, to], moments[SY, at])
    add(out[SZ, to], pz)
    add_twice_shifted(out[SXX, to], moments[SXX, at], px, count, shift)
    add_shifted(out[SXY, to], moments[SXY, at], moments[SY, at], shift)
    add(out[SYY, to], moments[SYY, at])
    add_shifted(out[SXZ, to], moments[SXZ, at], pz, shift)
    add(out[SYZ, to], moments[SYZ, at])


@row_loop
def add_rows(row, k, out):  # type: ignore[no-untyped-def]
    """Add the sums of the row `k` rows further on."""
    shift = np.float32(k)
    add(out[N], row[N])
    add(out[SX], row[SX])
    add_shifted(out[SY], row[SY], row[N], shift)
    add(out[SZ], row[SZ])
    add(out[SXX], row[SXX])
    add_shifted(out[SXY], row[SXY], row[SX], shift)
    add_twice_shifted(out[SYY], row[SYY], row[SY], row[N], shift)
    add(out[SXZ], row[SXZ])
    add_shifted(out[SYZ], row[SYZ], row[SZ], shift)


@row_loop
def subtract_means(product, a, b):  # type: ignore[no-untyped-def]
    """Take a b away."""
    for i in range(len(product)):
        product[i] -= a[i] * b[i]


@row_loop
def to_covariances(sums):  # type: ignore[no-untyped-def]
    """Sums of a row become means and covariances; the number of points stays."""
    for k in range(SX, SUMS):
        some, count = sums[k], sums[N]
        for i in range(len(count)):
            some[i] /= count[i]
    subtract_means(sums[SXX], sums[SX], sums[SX])
    subtract_means(sums[SXY], sums[SX], sums[SY])
    subtract_means(sums[SYY], sums[SY], sums[SY])
    subtract_means(sums[SXZ], sums[SX], sums[SZ])
    subtract_means(sums[SYZ], sums[SY], sums[SZ])


@row_loop
def put_determinants(z, count, xx, xy, yy, out):  # type: ignore[no-untyped-def]
    """Of the points' covariance; not a number where they do not carry a plane, or the cell has no ground."""
    least = np.float32(MIN_SPREAD)
    for i in range(len(out)):
        trace, determinant = xx[i] + yy[i], xx[i] * yy[i] - xy[i] * xy[i]
        # Both eigenvalues are at least `least`.
        spread = (trace >= least + least) & (determinant - least * trace + least * least >= 0)
        good = spread & (count[i] >= 3) & (z[i] == z[i])
        out[i] = determinant if good else np.float32(np.nan)


@row_loop
def put_rise(az, bz, bb, ab, determinant, scale, out):  # type: ignore[no-untyped-def]
    """Rise of the planes along a, from the covariances with the other coordinate, b [m per m]."""
    for i in range(len(out)):
        out[i] = scale * (az[i] * bb[i] - bz[i] * ab[i]) / determinant[i]


@row_loop
def put_centre(x, y, z, rise_x, rise_y, size, out):  # type: ignore[no-untyped-def]
    """Height at the cells' centres: from the hit along the plane, at most a cell's size up or down."""
    for i in range(len(out)):
        down = size * (rise_x[i] * x[i] + rise_y[i] * y[i])
        down = down if down == down else np.float32(0)
        down = size if down > size else down
        down = -size if down < -size else down
        out[i] = z[i] - down


@row_loop
def put_offset(x, mean_x, rise_x, size, out):  # type: ignore[no-untyped-def]
    """How much higher a plane is at x than at the mean."""
    for i in range(len(out)):
        out[i] = size * rise_x[i] * (x[i] - mean_x[i])


@row_loop
def put_residual(z, mean_z, along_x, along_y, out):  # type: ignore[no-untyped-def]
    """Squared distance of each hit from its plane, along z [m^2]."""
    for i in range(len(out)):
        off = z[i] - mean_z[i] - along_x[i] - along_y[i]
        out[i] = off * off


@map_loop
def fit_planes(first, last, blocks, radius, size, scratch):  # type: ignore[no-untyped-def]
    """Planes around the cells, for blocks `first` to `last` of the `blocks` that the rows are cut into.

    Args:
        radius: of the windows [cells].
        size: of a cell [m].
        scratch: reads x, y, height; writes rise_x, rise_y, centre, residual (`flatten_kernels.Scratch`).
    """
    n, window = scratch.height.shape[0], 2 * radius + 1
    for block in range(first, last):
        sums = scratch.sums[block]
        ring, total, moments = sums[:window], sums[window], sums[window + 1]
        begin, end = n * block // blocks, n * (block + 1) // blocks
        for ahead in range(begin - radius, end + radius):
            if 0 <= ahead < n:
                row = ring[ahead % window]
                put_moments(scratch.x[ahead], scratch.y[ahead], scratch.height[ahead], moments)
                row[:] = np.float32(0)
                for k in range(-radius, radius + 1):
                    add_columns(moments, k, row)
            j = ahead - radius
            if j < begin:
                continue
            total[:] = np.float32(0)
            for jj in range(max(0, j - radius), min(n, j + radius + 1)):
                add_rows(ring[jj % window], jj - j, total)
            solve_row(total, moments[0], moments[1], j, size, scratch)


@row_loop
def solve_row(total, line, other, j, size, scratch):  # type: ignore[no-untyped-def]
    """The planes of a row from its sums, and where its hits lie to them."""
    x, y, z, scale = scratch.x[j], scratch.y[j], scratch.height[j], np.float32(1) / size
    rise_x, rise_y = scratch.rise_x[j], scratch.rise_y[j]
    to_covariances(total)
    put_determinants(z, total[N], total[SXX], total[SXY], total[SYY], line)
    put_rise(total[SXZ], total[SYZ], total[SYY], total[SXY], line, scale, rise_x)
    put_rise(total[SYZ], total[SXZ], total[SXX], total[SXY], line, scale, rise_y)
    put_centre(x, y, z, rise_x, rise_y, size, scratch.centre[j])
    put_offset(x, total[SX], rise_x, size, line)
    put_offset(y, total[SY], rise_y, size, other)
    put_residual(z, total[SZ], line, other, scratch.residual[j])
