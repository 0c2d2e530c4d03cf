"""The ground of windows as pictures: the map's features as colours, as it was at each window's start."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.report.feature_colours import colour_limits, colours

PIXELS = 240
"""Width of a picture."""

GREY = 150
"""Shade of ground that no camera has seen."""

Square = tuple[tuple[float, float], float]
"""Middle (ahead, to the left) and half the width of a square in the frame of a window's start [m]."""


@dataclass(frozen=True)
class GroundPicture:
    """A square of ground from above; the heading at the start points up, left is left.

    Attributes:
        rgba: transparent where the map knows nothing.
        at_start: whether the map is as it was at the window's start; else as the whole drive left it.
    """

    rgba: UInt8[np.ndarray, "h w 4"]
    at_start: bool


def ground_pictures(
    dataset: Dataset,
    drive: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    poses: Float[np.ndarray, "n 3"],
    squares: Sequence[Square],
) -> list[GroundPicture | None]:
    """The ground of each window in the same colours; None where the dataset has no map with features.

    Args:
        drive, row: of the windows.
        poses: px, py, yaw at their starts, in the frame of the drive's rows.
        squares: what is drawn of each.
    """
    if not dataset.features:
        return [None] * len(row)
    sampled: list[tuple[np.ndarray, np.ndarray, bool] | None] = []
    whole: dict[int, TerrainMap] = {}
    for number, at, pose, square in zip(drive.tolist(), row.tolist(), poses, squares, strict=True):
        stored = dataset.drives[number]
        terrain, at_start = _snapshot(stored, at), True
        if terrain is None and stored.load_map is not None:
            whole[number] = whole[number] if number in whole else stored.load_map()
            terrain, at_start = whole[number], False
        place = pose + np.append(stored.rows.origin, 0.0)
        sampled.append(None if terrain is None else (*_sample(terrain, _pixels(place, square)), at_start))
    parts = [part[0].reshape(-1, part[0].shape[-1]) for part in sampled if part is not None]
    limits = colour_limits(np.concatenate(parts)) if parts else np.zeros((2, 3))
    return [None if part is None else GroundPicture(_coloured(part[0], part[1], limits), part[2]) for part in sampled]


def _snapshot(drive: StoredDrive, row: int) -> TerrainMap | None:
    """The map as it was at a row, where it was kept."""
    if drive.snapshots is None:
        return None
    (number,) = np.nonzero(drive.snapshots.row == row)
    return drive.snapshots.load(int(number[0])) if len(number) else None


def _pixels(pose: Float[np.ndarray, " 3"], square: Square) -> Float[np.ndarray, "h w 2"]:
    """World positions of a picture's pixels, the first row furthest ahead."""
    (ahead, left), half = square
    steps = half * (1 - (2 * np.arange(PIXELS) + 1) / PIXELS)
    forward, side = np.meshgrid(ahead + steps, left + steps, indexing="ij")
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.stack((pose[0] + cos * forward - sin * side, pose[1] + sin * forward + cos * side), axis=-1)


def _sample(
    terrain: TerrainMap, places: Float[np.ndarray, "h w 2"]
) -> tuple[Float[np.ndarray, "h w F"], Float[np.ndarray, "h w"]]:
    """Features (three at most) and elevation of the cells nearest to places; NaN outside and where unknown."""
    column, row = np.moveaxis(np.rint((places - terrain.origin) / terrain.resolution).astype(int), -1, 0)
    ny, nx = terrain.elevation.shape
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    row, column = row.clip(0, ny - 1), column.clip(0, nx - 1)
    features = np.asarray(terrain.features[row, column, :3], np.float32)
    return np.where(inside[..., None], features, np.nan), np.where(inside, terrain.elevation[row, column], np.nan)


def _coloured(
    features: Float[np.ndarray, "h w F"], elevation: Float[np.ndarray, "h w"], limits: Float[np.ndarray, "2 3"]
) -> UInt8[np.ndarray, "h w 4"]:
    """Features as colours, grey where there are none, transparent where there is no ground."""
    seen = np.isfinite(features).all(axis=-1)
    shade = np.where(seen[..., None], colours(features, limits), GREY)
    known = seen | np.isfinite(elevation)
    return np.concatenate((shade, np.where(known, 255, 0)[..., None]), axis=-1).astype(np.uint8)
