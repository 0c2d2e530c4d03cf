"""Surface normals and roughness from least-squares planes through the hits around each cell, by moving sums.

Planes give z over x, y, with each hit at its measured position. Sums are taken over the columns of a window, then over
its rows, relative to the window's centre, so that float32 suffices. Every inner loop writes a single row; otherwise
LLVM does not vectorise it.
"""

from typing import Final

import numpy as np

from offpiste.native.compilation import MAPPING

N, SX, SY, SZ, SXX, SXY, SYY, SXZ, SYZ = range(9)
"""Sums over the points of a window: count, x, y, z and products."""

SUMS: Final = 9

MIN_SPREAD: Final = 0.2
"""Minimum variance of a window's points in any direction [cells^2]: two adjacent full lines of cells have 0.25 or more,
a single one about 0.08."""


@MAPPING.loop
def put_product(a, b, out):  # type: ignore[no-untyped-def]
    """Write a b."""
    for i in range(len(out)):
        out[i] = a[i] * b[i]


@MAPPING.loop
def put_present(a, z, out):  # type: ignore[no-untyped-def]
    """Write a where z is a number, else 0."""
    for i in range(len(out)):
        out[i] = a[i] if z[i] == z[i] else np.float32(0)


@MAPPING.loop
def put_moments(x, y, z, radius, out):  # type: ignore[no-untyped-def]
    """Write the moments of each cell of a row; out: [SUMS, n + 2 radius], 0 at the ends."""
    inner = slice(radius, radius + len(z))
    count, px, py, pz = out[N, inner], out[SX, inner], out[SY, inner], out[SZ, inner]
    for i in range(len(count)):
        count[i] = np.float32(1) if z[i] == z[i] else np.float32(0)
    put_present(x, z, px)
    put_present(y, z, py)
    put_present(z, z, pz)
    put_product(px, px, out[SXX, inner])
    put_product(px, py, out[SXY, inner])
    put_product(py, py, out[SYY, inner])
    put_product(px, pz, out[SXZ, inner])
    put_product(py, pz, out[SYZ, inner])


@MAPPING.loop
def put(a, out):  # type: ignore[no-untyped-def]
    """Copy a."""
    for i in range(len(out)):
        out[i] = a[i]


@MAPPING.loop
def add(out, a, b):  # type: ignore[no-untyped-def]
    """Add the sums of two cells on either side."""
    for i in range(len(out)):
        out[i] += a[i] + b[i]


@MAPPING.loop
def add_first(out, a, b, lower_a, lower_b, shift):  # type: ignore[no-untyped-def]
    """Add sums over a coordinate relative to the cells at +shift and at -shift."""
    for i in range(len(out)):
        out[i] += a[i] + b[i] + shift * (lower_a[i] - lower_b[i])


@MAPPING.loop
def add_second(out, a, b, lower_a, lower_b, lowest_a, lowest_b, shift):  # type: ignore[no-untyped-def]
    """Add sums over the square of that coordinate."""
    twice, squared = shift + shift, shift * shift
    for i in range(len(out)):
        out[i] += a[i] + b[i] + twice * (lower_a[i] - lower_b[i]) + squared * (lowest_a[i] + lowest_b[i])


@MAPPING.inlined
def add_shifted(a, b, shift, out, u, v, uu, vv, uz, vz):  # type: ignore[no-untyped-def]
    """Add the sums of the cells at +shift and at -shift along the coordinate u; v is the other coordinate."""
    add(out[N], a[N], b[N])
    add_first(out[u], a[u], b[u], a[N], b[N], shift)
    add(out[v], a[v], b[v])
    add(out[SZ], a[SZ], b[SZ])
    add_second(out[uu], a[uu], b[uu], a[u], b[u], a[N], b[N], shift)
    add_first(out[SXY], a[SXY], b[SXY], a[v], b[v], shift)
    add(out[vv], a[vv], b[vv])
    add_first(out[uz], a[uz], b[uz], a[SZ], b[SZ], shift)
    add(out[vz], a[vz], b[vz])


@MAPPING.loop
def add_columns(a, b, shift, out):  # type: ignore[no-untyped-def]
    """Add the sums of the cells at +shift and at -shift in the row."""
    add_shifted(a, b, shift, out, SX, SY, SXX, SYY, SXZ, SYZ)


@MAPPING.loop
def sum_columns(moments, radius, out):  # type: ignore[no-untyped-def]
    """Sum over the cells up to `radius` to the left and to the right."""
    n = out.shape[1]
    for q in range(SUMS):
        put(moments[q, radius : radius + n], out[q])
    for k in range(1, radius + 1):
        right, left = slice(radius + k, radius + k + n), slice(radius - k, radius - k + n)
        add_columns(moments[:, right], moments[:, left], np.float32(k), out)


@MAPPING.loop
def sum_rows(ring, j, radius, out):  # type: ignore[no-untyped-def]
    """Sum over the rows up to `radius` below and above row j; row jj is ring[jj mod its length]."""
    window = len(ring)
    for q in range(SUMS):
        put(ring[j % window, q], out[q])
    for k in range(1, radius + 1):
        add_shifted(ring[(j + k) % window], ring[(j - k) % window], np.float32(k), out, SY, SX, SYY, SXX, SYZ, SXZ)


@MAPPING.loop
def subtract_means(product, a, b):  # type: ignore[no-untyped-def]
    """Subtract a b."""
    for i in range(len(product)):
        product[i] -= a[i] * b[i]


@MAPPING.loop
def to_covariances(sums):  # type: ignore[no-untyped-def]
    """Convert the sums of a row into means and covariances."""
    for k in range(SX, SUMS):
        some, count = sums[k], sums[N]
        for i in range(len(count)):
            some[i] /= count[i]
    subtract_means(sums[SXX], sums[SX], sums[SX])
    subtract_means(sums[SXY], sums[SX], sums[SY])
    subtract_means(sums[SYY], sums[SY], sums[SY])
    subtract_means(sums[SXZ], sums[SX], sums[SZ])
    subtract_means(sums[SYZ], sums[SY], sums[SZ])


@MAPPING.loop
def put_determinants(z, count, xx, xy, yy, out):  # type: ignore[no-untyped-def]
    """Write determinants of the covariance, NaN where the points define no plane or the cell has no ground."""
    least = np.float32(MIN_SPREAD)
    for i in range(len(out)):
        trace, determinant = xx[i] + yy[i], xx[i] * yy[i] - xy[i] * xy[i]
        # Both eigenvalues are at least `least`.
        spread = (trace >= least + least) & (determinant - least * trace + least * least >= 0)
        good = spread & (count[i] >= 3) & (z[i] == z[i])
        out[i] = determinant if good else np.float32(np.nan)


@MAPPING.loop
def put_rise(az, bz, bb, ab, determinant, scale, out):  # type: ignore[no-untyped-def]
    """Write the rise of the planes along a [m/m]; b is the other coordinate."""
    for i in range(len(out)):
        out[i] = scale * (az[i] * bb[i] - bz[i] * ab[i]) / determinant[i]


@MAPPING.loop
def put_centre(x, y, z, rise_x, rise_y, size, out):  # type: ignore[no-untyped-def]
    """Write heights at cell centres: from the hit along the plane, by at most the size of a cell."""
    for i in range(len(out)):
        down = size * (rise_x[i] * x[i] + rise_y[i] * y[i])
        down = down if down == down else np.float32(0)
        down = size if down > size else down
        down = -size if down < -size else down
        out[i] = z[i] - down


@MAPPING.loop
def put_offset(x, mean_x, rise_x, size, out):  # type: ignore[no-untyped-def]
    """Write the rise of the plane from the mean to x."""
    for i in range(len(out)):
        out[i] = size * rise_x[i] * (x[i] - mean_x[i])


@MAPPING.loop
def put_residual(z, mean_z, along_x, along_y, out):  # type: ignore[no-untyped-def]
    """Write the squared vertical distance of each hit from its plane [m^2]."""
    for i in range(len(out)):
        off = z[i] - mean_z[i] - along_x[i] - along_y[i]
        out[i] = off * off


@MAPPING.entry
def fit_planes(first, last, blocks, radius, size, buffers):  # type: ignore[no-untyped-def]
    """Fit planes around all cells of the row blocks `first` to `last`.

    Args:
        radius: radius of the windows [cells].
        buffers: reads x, y, height; writes rise_x, rise_y, centre, residual (`voxels_to_layers.Buffers`).
    """
    n, window = buffers.height.shape[0], 2 * radius + 1
    for block in range(first, last):
        ring, total, moments = buffers.sums[block, :window], buffers.sums[block, window], buffers.moments[block]
        begin, end = n * block // blocks, n * (block + 1) // blocks
        for ahead in range(begin - radius, end + radius):
            row = ring[ahead % window]
            if 0 <= ahead < n:
                x, y, z = buffers.x[ahead], buffers.y[ahead], buffers.height[ahead]
                put_moments(x, y, z, radius, moments)
                sum_columns(moments, radius, row)
            else:
                row[:] = np.float32(0)
            j = ahead - radius
            if j >= begin:
                sum_rows(ring, j, radius, total)
                solve_row(total, buffers.line[block, 0], buffers.line[block, 1], j, size, buffers)


@MAPPING.loop
def solve_row(total, line, other, j, size, buffers):  # type: ignore[no-untyped-def]
    """Solve for the planes of a row and the residuals of its hits."""
    x, y, z, rise_x, rise_y = buffers.x[j], buffers.y[j], buffers.height[j], buffers.rise_x[j], buffers.rise_y[j]
    solve(total, x, y, z, size, line, rise_x, rise_y, buffers.centre[j])
    put_offset(x, total[SX], rise_x, size, line)
    put_offset(y, total[SY], rise_y, size, other)
    put_residual(z, total[SZ], line, other, buffers.residual[j])


@MAPPING.loop
def solve(total, x, y, z, size, line, rise_x, rise_y, centre):  # type: ignore[no-untyped-def]
    """Solve for planes from their sums."""
    scale = np.float32(1) / size
    to_covariances(total)
    put_determinants(z, total[N], total[SXX], total[SXY], total[SYY], line)
    put_rise(total[SXZ], total[SYZ], total[SYY], total[SXY], line, scale, rise_x)
    put_rise(total[SYZ], total[SXZ], total[SXX], total[SXY], line, scale, rise_y)
    put_centre(x, y, z, rise_x, rise_y, size, centre)


@MAPPING.loop
def add_row(out, a):  # type: ignore[no-untyped-def]
    """Add a."""
    for i in range(len(out)):
        out[i] += a[i]


@MAPPING.entry
def smooth_residuals(first, last, blocks, radius, buffers):  # type: ignore[no-untyped-def]
    """Write the roughness: root mean square of the residuals in the window of each cell with a plane."""
    n = buffers.height.shape[0]
    for block in range(first, last):
        room = buffers.sums[block, 0]
        count, total, near_count, near_total = room[0], room[1], room[2], room[3]
        for j in range(n * block // blocks, n * (block + 1) // blocks):
            room[:] = np.float32(0)
            for jj in range(max(0, j - radius), min(n, j + radius + 1)):
                residual = buffers.residual[jj]
                for i in range(n):
                    count[i] += np.float32(1) if residual[i] == residual[i] else np.float32(0)
                for i in range(n):
                    total[i] += residual[i] if residual[i] == residual[i] else np.float32(0)
            for k in range(-radius, radius + 1):
                to, at = slice(max(0, -k), min(n, n - k)), slice(max(0, k), min(n, n + k))
                add_row(near_count[to], count[at])
                add_row(near_total[to], total[at])
            rise, roughness = buffers.rise_x[j], buffers.roughness[j]
            for i in range(n):
                value = np.sqrt(near_total[i] / near_count[i])
                roughness[i] = value if rise[i] == rise[i] else np.float32(np.nan)
