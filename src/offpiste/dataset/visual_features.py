"""Visual features of the cells under the wheels of a drive, by feature set."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from offpiste.dataset.feature_sets import FeatureSetRecorder
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.map_snapshots import CellList, SnapshotSchedule, SnapshotSettings, SnapshotWriter, crop
from offpiste.dataset.resample import Rows
from offpiste.dataset.wheel_passes import find_passes
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog
from offpiste.mapping.pipeline import MapPipeline
from offpiste.mapping.replay import MapperSettings, Moment, pinhole_cameras, replay
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.mapping.voxels_to_layers import MapCells
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.rig.rig import Rig


@dataclass
class SnapshotKeeper:
    """Recorder of map snapshots at the start of windows."""

    writer: SnapshotWriter
    schedule: SnapshotSchedule
    settings: SnapshotSettings
    rows: Rows
    poses: Poses
    _row: int = field(default=-1, init=False)
    _cells: CellList | None = field(default=None, init=False)

    def update(self, moment: Moment) -> None:
        """Keep the map of this moment if a window starts in the first row at which it was known.

        Points and images are known a latency after their measurement, and not before the poses that place them. The
        last moment of a row counts: it holds the scans of all LiDARs. After a jump of the poses, the frames differ.
        """
        row = int(np.searchsorted(self.rows.time, max(moment.measured + self.settings.latency, moment.placed)))
        if row != self._row and self.schedule.at(row):
            self._write()
            self._row = row
        if row != self._row or self.poses.stretch(self.rows.time[row]) != self.poses.stretch(moment.time):
            return
        state = self.rows.state_causal[row].astype(np.float64)
        state[:2] += self.rows.origin
        self._cells = crop(moment.layers.terrain_map(), state)

    def close(self) -> None:
        """Write the last map and the index of all, once the drive is over."""
        self._write()
        self.writer.close()

    def _write(self) -> None:
        if self._cells is not None:
            self.writer.add(self._row, self._cells)
        self._cells = None


def with_visual_features(
    rows: Rows,
    log: SensorLog,
    rig: Rig,
    extractor: FeatureExtractor,
    settings: MapperSettings | None = None,
    *,
    snapshots: SnapshotKeeper | None = None,
    report: Callable[[float], None] = lambda share: None,
) -> Rows:
    """Replay a drive's sensors and record the features of its cells (paper, "Dataset Extraction").

    Args:
        snapshots: records maps at the start of validation and test windows.
        report: called with the replayed share of the drive.
    """
    settings = settings or MapperSettings()
    grid = settings.map.voxels
    xy = rows.world_xy
    wheels = wheel_positions(xy, rows.state[:, 2].astype(np.float64), rig.wheel_positions())
    passes = find_passes(rows.time, xy, wheels, resolution=grid.size, jumps=log.poses.jumps)
    recorder = FeatureSetRecorder(passes, resolution=grid.size, reach=grid.reach, features=extractor.channels)
    cameras = pinhole_cameras(log, extractor.patch)
    for moment in replay(log, cameras, extractor.extract, extractor.channels, settings):
        recorder.update(moment.time, moment.vehicle[:2], _reader(moment.map))
        if snapshots is not None:
            snapshots.update(moment)
        report(float(np.clip((moment.time - rows.time[0]) / (rows.time[-1] - rows.time[0]), 0, 1)))
    under = passes.index
    unknown = np.full((len(recorder.normal), 1, 3), np.nan, np.float32)
    normal = np.concatenate((recorder.normal, unknown), axis=1)[:, under]  # -1 is the last
    cells = Cells(under, recorder.features, recorder.valid, recorder.distance, recorder.elevation)
    return replace(rows, normal=normal, cells=cells)


def _reader(terrain: MapPipeline) -> Callable[[np.ndarray], MapCells]:
    grid = terrain.voxel_map
    first = np.floor(grid.origin / grid.settings.size).astype(np.int64)  # the origin is a centre: cell i starts at i

    def read(cells: np.ndarray) -> MapCells:
        at = cells - first
        inside = np.asarray(((at >= 0) & (at < grid.cells)).all(axis=1))
        column, row = np.where(inside[:, None], at, 0).T
        there = terrain.cells(row, column)
        for values in there:
            values[~inside] = False if values.dtype == bool else np.nan
        return there

    return read
