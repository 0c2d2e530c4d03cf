"""Sample a world's grids: elevation, normals, properties and kind of the ground under a wheel.

Compiled functions of plain scalars, as called thousands of times a second; places beyond the border read the border.
`read_grid` samples many places at once: the reference in tests, and for everything that is not critical.
"""

import numpy as np
from jaxtyping import Float, Shaped

from offpiste.compilation import PHYSICS


@PHYSICS.entry
def _cell(distance, resolution, nodes):  # type: ignore[no-untyped-def]
    # Index and fraction are both clamped; written so that NaN reads the border too instead of crashing.
    position = distance / resolution
    if not position > 0.0:
        position = 0.0
    if position > nodes - 1:
        position = nodes - 1.0
    index = min(int(position), nodes - 2)
    return index, position - index


@PHYSICS.entry
def height(elevation, x0, y0, resolution, x, y):  # type: ignore[no-untyped-def]
    """Elevation at (x, y), bilinear [m].

    Args:
        elevation: [ny, nx], at least 2 x 2 [m].
        x0, y0: position of node [0, 0] [m].
        resolution: distance between nodes [m].
    """
    i, u = _cell(x - x0, resolution, elevation.shape[1])
    j, v = _cell(y - y0, resolution, elevation.shape[0])
    near = elevation[j, i] * (1.0 - u) + elevation[j, i + 1] * u
    far = elevation[j + 1, i] * (1.0 - u) + elevation[j + 1, i + 1] * u
    return near * (1.0 - v) + far * v


@PHYSICS.entry
def normal(elevation, x0, y0, resolution, x, y):  # type: ignore[no-untyped-def]
    """Unit normal (nx, ny, nz), pointing up, of the bilinear surface at (x, y), in the world frame.

    Args: as in `height`.
    """
    i, u = _cell(x - x0, resolution, elevation.shape[1])
    j, v = _cell(y - y0, resolution, elevation.shape[0])
    a, b = elevation[j, i], elevation[j, i + 1]
    c, d = elevation[j + 1, i], elevation[j + 1, i + 1]
    slope_x = ((b - a) * (1.0 - v) + (d - c) * v) / resolution
    slope_y = ((c - a) * (1.0 - u) + (d - b) * u) / resolution
    scale = 1.0 / np.sqrt(slope_x * slope_x + slope_y * slope_y + 1.0)
    return -slope_x * scale, -slope_y * scale, scale


@PHYSICS.entry
def properties_at(properties, x0, y0, resolution, x, y, out):  # type: ignore[no-untyped-def]
    """Properties of the ground at (x, y), bilinear.

    Args:
        properties: [ny, nx, 4].
        out: [4], overwritten.
    """
    i, u = _cell(x - x0, resolution, properties.shape[1])
    j, v = _cell(y - y0, resolution, properties.shape[0])
    for p in range(properties.shape[2]):
        near = properties[j, i, p] * (1.0 - u) + properties[j, i + 1, p] * u
        far = properties[j + 1, i, p] * (1.0 - u) + properties[j + 1, i + 1, p] * u
        out[p] = near * (1.0 - v) + far * v


@PHYSICS.entry
def main_kind(kinds, x0, y0, resolution, x, y):  # type: ignore[no-untyped-def]
    """Index of the kind with the largest share at the node nearest to (x, y); the first of equals.

    Args:
        kinds: [K, ny, nx].
    """
    i, u = _cell(x - x0, resolution, kinds.shape[2])
    j, v = _cell(y - y0, resolution, kinds.shape[1])
    if u >= 0.5:
        i += 1
    if v >= 0.5:
        j += 1
    best = 0
    for k in range(1, kinds.shape[0]):
        if kinds[k, j, i] > kinds[best, j, i]:
            best = k
    return best


def read_grid(
    grid: Shaped[np.ndarray, "ny nx ..."],
    origin: tuple[float, float],
    resolution: float,
    places: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n ..."]:
    """Values of a grid at many places, bilinear, clamped at the border.

    Args:
        grid: e.g. `World.elevation` or `World.properties`.
        origin, resolution: as in `World` [m].
        places: x, y [m].
    """
    nodes = np.array(grid.shape[1::-1])
    position = np.clip((places - np.array(origin)) / resolution, 0, nodes - 1)
    index = np.minimum(position.astype(int), nodes - 2)
    (i, j), (u, v) = index.T, (position - index).T
    u, v = (weight.reshape(-1, *[1] * (grid.ndim - 2)) for weight in (u, v))
    near = grid[j, i] * (1 - u) + grid[j, i + 1] * u
    far = grid[j + 1, i] * (1 - u) + grid[j + 1, i + 1] * u
    return near * (1 - v) + far * v


def normals_of(elevation: Float[np.ndarray, "ny nx"], resolution: float) -> Float[np.ndarray, "ny nx 3"]:
    """Unit normals at the nodes, from central differences."""
    slope_y, slope_x = np.gradient(elevation, resolution)
    normals = np.stack((-slope_x, -slope_y, np.ones_like(slope_x)), axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)
