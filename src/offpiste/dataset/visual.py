"""Visual features for the rows of a drive: what the map held of every cell under the wheels, by distance."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from offpiste.dataset.cells import Cells
from offpiste.dataset.extract import Rows
from offpiste.dataset.passes import find_passes
from offpiste.dataset.viewing import CellViews, Viewing
from offpiste.logs.sensors import SensorLog
from offpiste.mapping.layers import TerrainLayers
from offpiste.mapping.replay import ReplaySettings, pinhole_cameras, replay
from offpiste.mapping.terrain import wheel_places
from offpiste.perception.looking import Looking
from offpiste.rig import Rig

UP = np.array([0, 0, 1], np.float32)
"""The normal where none is known."""


def with_visual_features(
    rows: Rows,
    log: SensorLog,
    rig: Rig,
    looking: Looking,
    settings: ReplaySettings | None = None,
) -> Rows:
    """Play a drive's sensors back and keep what its cells looked like (paper, "Dataset Extraction").

    Raises:
        LogError: the log's sensors are damaged or of no use.
    """
    settings = settings or ReplaySettings()
    grid = settings.map.voxels
    xy = rows.state[:, :2].astype(np.float64) + rows.origin
    wheels = wheel_places(xy, rows.state[:, 2].astype(np.float64), rig.wheel_positions())
    passes = find_passes(rows.time, xy, wheels, resolution=grid.size)
    viewing = Viewing(passes, resolution=grid.size, reach=grid.reach, features=looking.channels)
    cameras = pinhole_cameras(log, looking.patch)
    for moment in replay(log, cameras, looking.look, looking.channels, settings):
        viewing.update(moment.time, moment.vehicle[:2], _reader(moment.layers))
    under = passes.index
    normal = np.where((under >= 0)[None, :, :, None], viewing.normal[:, under], UP)
    cells = Cells(under, viewing.features, viewing.valid, viewing.distance, viewing.elevation)
    return replace(rows, normal=normal.astype(np.float32), cells=cells)


def _reader(layers: TerrainLayers) -> Callable[[np.ndarray], CellViews]:
    first = np.round(layers.origin / layers.resolution).astype(np.int64)
    ny, nx = layers.elevation.shape

    def read(cells: np.ndarray) -> CellViews:
        at = cells - first
        inside = np.asarray(((at >= 0) & (at < [nx, ny])).all(axis=1))
        column, row = np.where(inside[:, None], at, 0).T
        valid, ground = inside & layers.valid[row, column], inside & layers.known[row, column]
        normal = layers.normal[row, column].astype(np.float32)
        known = inside & np.isfinite(normal).all(axis=1)
        return CellViews(
            features=np.where(valid[:, None], layers.features[row, column], np.nan).astype(np.float32),
            valid=valid,
            distance=np.where(valid, layers.distance[row, column], np.nan).astype(np.float32),
            elevation=np.where(ground, layers.elevation[row, column], np.nan).astype(np.float32),
            normal=np.where(known[:, None], normal, UP),
        )

    return read
