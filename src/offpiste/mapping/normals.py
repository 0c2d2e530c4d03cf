"""Surface normals and roughness from least-squares planes through the hits around each cell, by moving sums.

Planes give z over x, y, with each hit at its measured position. Sums are taken along the rows of a window, then over
its rows, relative to the window's centre, so that float32 suffices.
"""

from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.mapping.ground import HEIGHT, RESIDUAL, RISE_X, ROUGHNESS
from offpiste.native.library import compiled

MIN_SPREAD: Final = 0.2
"""Minimum variance of a window's points in any direction [cells^2]: two adjacent full lines of cells have 0.25 or more,
a single one about 0.08."""


@compiled(int, int, int, float, "f4", int, int)
def fit_planes(first, last, radius, size, grids, cells, border):  # type: ignore[no-untyped-def]
    """Fit planes around the cells of the rows `first` to `last` - 1.

    Args:
        radius: radius of the windows [cells].
        size: size of a cell [m].
        grids: reads hits, writes rise, centre and residual; `border` cells around [cells, cells] (`ground.make_grids`).
    """
    sums = np.zeros((9, last - first, cells))
    for down, right in product(range(-radius, radius + 1), repeat=2):
        x, y, z = _shifted(grids[: HEIGHT + 1], first + down, last + down, right, cells, border).astype(np.float64)
        x, y = x + right, y + down
        moments = np.stack((np.ones_like(x), x, y, z, x * x, x * y, y * y, x * z, y * z))
        sums += np.where(np.isnan(z), 0, moments)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_x, mean_y, mean_z, xx, xy, yy, xz, yz = sums[1:] / sums[0]
        xx, xy, yy = xx - mean_x * mean_x, xy - mean_x * mean_y, yy - mean_y * mean_y
        xz, yz = xz - mean_x * mean_z, yz - mean_y * mean_z
        trace, determinant = xx + yy, xx * yy - xy * xy
        x, y, z = _shifted(grids[: HEIGHT + 1], first, last, 0, cells, border)
        # Both eigenvalues are at least `MIN_SPREAD`.
        good = (trace >= 2 * MIN_SPREAD) & (determinant - MIN_SPREAD * trace + MIN_SPREAD**2 >= 0)
        determinant = size * np.where(good & (sums[0] >= 3) & ~np.isnan(z), determinant, np.nan)
        rise_x, rise_y = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
        down = np.nan_to_num(size * (rise_x * x + rise_y * y)).clip(-size, size)
        residual = (z - mean_z - size * (rise_x * (x - mean_x) + rise_y * (y - mean_y))) ** 2
    _shifted(grids[RISE_X : RESIDUAL + 1], first, last, 0, cells, border)[:] = rise_x, rise_y, z - down, residual


@compiled(int, int, int, "f4", int, int)
def smooth_residuals(first, last, radius, grids, cells, border):  # type: ignore[no-untyped-def]
    """Write the roughness: root mean square of the residuals in the window of each cell with a plane."""
    count, total = np.zeros((2, last - first, cells))
    for down, right in product(range(-radius, radius + 1), repeat=2):
        residual = _shifted(grids[RESIDUAL], first + down, last + down, right, cells, border)
        count += ~np.isnan(residual)
        total += np.nan_to_num(residual)
    known = ~np.isnan(_shifted(grids[RISE_X], first, last, 0, cells, border))
    roughness = np.sqrt(np.divide(total, count, out=np.full_like(total, np.nan), where=known))
    _shifted(grids[ROUGHNESS], first, last, 0, cells, border)[:] = roughness


def _shifted(
    grids: Float[np.ndarray, "*g rows columns"], first: int, last: int, right: int, cells: int, border: int
) -> Float[np.ndarray, "*g r n"]:
    """Return a view of the rows `first` to `last` - 1, with columns from `right`."""
    return grids[..., border + first : border + last, border + right : border + right + cells]
