"""Loops over the points of a scan that is projected into one image; the same in plain NumPy is in tests/perception.

Sums are added in the order in which NumPy and BLAS add them.
"""

import numpy as np

from offpiste.compilation import FUSED_PROJECTION, PROJECTION


@FUSED_PROJECTION.entry
def put_in_camera(points, camera_from_world, result):  # type: ignore[no-untyped-def]
    """Move points by one transform.

    Args:
        points: [n, 3].
        camera_from_world: [4, 4].
        result: where they go [n, 3].
    """
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for axis in range(3):
            row = camera_from_world[axis]
            result[i, axis] = (x * row[0] + y * row[1] + z * row[2]) + row[3]


@PROJECTION.entry
def put_pixels(points, matrix, nearest, width, height, index, pixels, depth):  # type: ignore[no-untyped-def] # noqa: PLR0913
    """Put the pixels of the points that fall into an image; returns how many do.

    Args:
        points: in the camera's frame [n, 3].
        matrix: K of the pinhole [3, 3].
        nearest: least depth [m].
        width, height: of the image [px].
        index: numbers of those points [n, or less used].
        pixels, depth: of those points [n, 2], [n].
    """
    count = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not z > nearest:  # nor what is not a number
            continue
        across = matrix[0, 0] * x / z + matrix[0, 1] * y / z + matrix[0, 2]
        down = matrix[1, 1] * y / z + matrix[1, 2]
        if across > -0.5 and across < width - 0.5 and down > -0.5 and down < height - 0.5:
            index[count], pixels[count, 0], pixels[count, 1], depth[count] = i, across, down, z
            count += 1
    return count


@PROJECTION.entry
def keep_better(number, points, index, pixels, occluded, patches, free, time, best, out):  # type: ignore[no-untyped-def] # noqa: PLR0913
    """Let a view show those points that it shows better than the views before it.

    Args:
        number: of the view.
        points: in the camera's frame [n, 3].
        index, pixels: of those that fall into the image [m], [m, 2].
        occluded: which of them are not seen [m].
        patches: x, y of the first patch, and side of a patch [px].
        free: patches that show the world [rows, columns].
        time: of the image, where the newest is the best; not a number where the most central is.
        best: cost of what shows each point so far [n].
        out: arrays of `Projection`.
    """
    rows, columns = free.shape
    first_x, first_y, size = patches
    shown, pixel, patch_row, patch_column, distance = out
    for k in range(len(index)):
        if occluded[k]:
            continue
        across, down = pixels[k, 0], pixels[k, 1]
        column = np.floor((across + 0.5 - first_x) / size)
        row = np.floor((down + 0.5 - first_y) / size)
        if not (column >= 0 and row >= 0 and column < columns and row < rows):
            continue
        r, c, i = np.int64(row), np.int64(column), index[k]
        if not free[r, c]:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        far = np.sqrt((x * x + y * y) + z * z)
        cost = -time if time == time else -z / far
        if cost < best[i]:
            best[i], shown[i], distance[i] = cost, number, far
            pixel[i, 0], pixel[i, 1], patch_row[i], patch_column[i] = across, down, r, c


@PROJECTION.entry
def gather_features(number, shown, row, column, image, out):  # type: ignore[no-untyped-def]
    """Put the features of the patches of the points that a view shows [n, F]; others are left as they are."""
    for i in range(len(shown)):
        if shown[i] == number:
            for k in range(image.shape[2]):
                out[i, k] = image[row[i], column[i], k]
