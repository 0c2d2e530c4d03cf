"""Pictures of a recorded drive: its sensors and its map; and a Rerun recording."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from offpiste.core.errors import LogError, RigError, installation_of, is_installed
from offpiste.core.files import write_bytes
from offpiste.core.progress import track
from offpiste.inspection.map_health import check_map_health, find_pits, map_health
from offpiste.inspection.sensor_samples import gather
from offpiste.logs.log import Log
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.mapping.replay import MapperSettings, Moment, pinhole_cameras, replay
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.report.figure import png
from offpiste.rig.rig import Rig
from offpiste.visualization.images import Album, contact_sheet, times_between, write_png
from offpiste.visualization.map_figure import FEATURED, Mosaic, draw_map
from offpiste.visualization.rerun_recording import Recorder
from offpiste.visualization.sensor_timing import draw_sensors, stamps_of

logger = logging.getLogger(__name__)

PATCH = 14
"""Side of a patch where no features are computed [px]."""

PATH_STEP = 0.1
"""Time between places of the wheels' tracks [s]."""

EARLIER = 1.0
"""Images are processed from this long before the first scan [s]."""

MOSAIC_METRES = 2.0
"""The mosaic is updated when the vehicle has driven this far [m]."""

NEAR = 25.0
"""Half the side of the closer map [m]."""


@dataclass(frozen=True)
class _Drive:
    """A stretch of a drive that is played back.

    Attributes:
        start, end: first and last scan of the stretch [s].
        scans: how many there are.
        limits: colours of the features; None without.
        poses: `world_from_body` every `PATH_STEP` of the stretch.
        wheels: places of the wheels then [m].
    """

    log: SensorLog
    extractor: FeatureExtractor | None
    start: float
    end: float
    scans: int
    limits: Float[np.ndarray, "2 3"] | None
    poses: Float[np.ndarray, "N 4 4"]
    wheels: Float[np.ndarray, "N 4 3"]


def view_log(
    log: Log,
    rig: Rig,
    out: Path,
    *,
    extractor: FeatureExtractor | None = None,
    stretch: tuple[float, float] = (0.0, np.inf),
    rrd: bool = True,
) -> list[Path]:
    """Write sensors.png, overlay.png, features.png (with features), map.png, map-near.png, and drive.rrd.

    Args:
        extractor: computes the features of images.
        stretch: first and last second after the first pose [s].
        rrd: write a recording, too; without its package a line says so, and pictures are made all the same.

    Returns:
        what was written, each whole.

    Raises:
        LogError, RigError: nothing of this log, or of this stretch, can be viewed with this rig.
    """
    drive = _open(log, rig, extractor, stretch)
    sensors = drive.log
    for note in (*sensors.notes, *sensors.coverage()):
        logger.info(f"  {note}")
    if rrd and not is_installed("rerun"):
        logger.info(
            f"no recording: rerun-sdk is not installed ({installation_of('view')}); pictures are made without it"
        )
        rrd = False
    written = [out / "sensors.png"]
    write_bytes(written[0], png(draw_sensors(stamps_of(sensors), stretch)))
    reach = MapperSettings().map.voxels
    known = drive.poses[np.isfinite(drive.poses).all(axis=(1, 2)), :2, 3]
    health = map_health(sensors.lidars, gather(sensors, {}), sensors.poses)
    logger.info(f"  first minute: {health}")
    for finding in check_map_health(health):
        logger.info(f"  {finding.severity}: {finding.where}: {finding.what}; {finding.remedy}")
    mosaic = Mosaic(known.min(axis=0) - reach.reach - 1, known.max(axis=0) + reach.reach + 1, reach.size)
    album = Album(times_between(drive.start, drive.end), drive.limits, len(sensors.cameras))
    with _recording(drive, out / "drive.rrd" if rrd else None) as recorder:
        last = _play(drive, mosaic, album, recorder)
    written += [out / "drive.rrd"] if rrd else []
    written += _write_album(album, out)
    written += _write_maps(drive, mosaic, last, out)
    ground = mosaic.ground().known
    logger.info(
        f"{drive.end - drive.start:.1f} s; {(ground > 0).sum() * (reach.size * mosaic.step) ** 2:.0f} m2 of ground, "
        f"{(ground == FEATURED).sum() / max((ground > 0).sum(), 1):.0%} of it with features"
    )
    return written


def _open(log: Log, rig: Rig, extractor: FeatureExtractor | None, stretch: tuple[float, float]) -> _Drive:
    if not rig.lidars and not rig.cameras:
        raise RigError(
            f"rig '{rig.name}' names no cameras and no LiDARs, so there is nothing to see",
            where=log.path,
            how="add [cameras.NAME] and [lidars.NAME] (docs/rig.md); `offpiste inspect` shows the other channels",
        )
    sensors = open_sensors(log, rig)
    if not sensors.lidars:
        raise LogError(
            f"has cameras ({', '.join(sensors.cameras)}) and no LiDAR, without which there is no map",
            where=log.path,
            how="record a LiDAR too, or name it in the rig",
        )
    first, last = sensors.poses.span
    scans = np.concatenate([sensors.stamps(name) for name in sensors.lidars])
    scans = scans[(scans >= max(first, first + stretch[0])) & (scans <= min(last, first + stretch[1]))]
    if not len(scans):
        raise LogError(
            f"no scan from {stretch[0]:g} to {stretch[1]:g} s; its poses last {last - first:.1f} s",
            where=log.path,
            how="change --seconds",
        )
    start, end = float(scans.min()), float(scans.max())
    poses = sensors.poses.at(np.append(np.arange(start, end, PATH_STEP), end))
    if not np.isfinite(poses).all(axis=(1, 2)).any():
        raise LogError("no pose in that stretch", where=log.path, how="change --seconds")
    spread = None if extractor is None else 2 * np.sqrt(extractor.pca.variance[:3].astype(np.float64))
    limits = None if spread is None else np.stack((-_three(spread), _three(spread)))
    return _Drive(sensors, extractor, start, end, len(scans), limits, poses, _wheels(poses, rig))


def _three(spread: Float[np.ndarray, " n"]) -> Float[np.ndarray, " 3"]:
    """Two standard deviations of the first three components; a lacking one does not vary."""
    return np.pad(spread, (0, 3 - len(spread)))


def _wheels(poses: Float[np.ndarray, "N 4 4"], rig: Rig) -> Float[np.ndarray, "N 4 3"]:
    """Places of the wheels at the height of the pose point."""
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    places = wheel_positions(poses[:, :2, 3], yaw, rig.wheel_positions())
    return np.concatenate((places, np.repeat(poses[:, None, 2:3, 3], 4, axis=1)), axis=2)


@contextmanager
def _recording(drive: _Drive, path: Path | None) -> Iterator[Recorder | None]:
    """A recorder whose file is in its place when all went well, and nowhere otherwise."""
    if path is None:
        yield None
        return
    partial = path.with_name(f".{path.name}.partial.rrd")
    path.parent.mkdir(parents=True, exist_ok=True)
    origin = drive.poses[np.isfinite(drive.poses).all(axis=(1, 2))][0, :3, 3]
    recorder = Recorder(partial, origin, drive.limits, tuple(drive.log.cameras))
    try:
        recorder.add_path(drive.wheels)
        recorder.add_vehicle(drive.log.rig.wheel_positions())
        yield recorder
        recorder.close()
        partial.replace(path)
    finally:
        recorder.close()
        partial.unlink(missing_ok=True)


def _play(drive: _Drive, mosaic: Mosaic, album: Album, recorder: Recorder | None) -> Moment:
    log, extractor = drive.log, drive.extractor
    cameras = pinhole_cameras(log, extractor.patch if extractor else PATCH)
    look, channels = (extractor.extract, extractor.channels) if extractor else (_blind, 0)
    played = replay(log, cameras, look, channels, start=drive.start - EARLIER, end=drive.end)
    moment, before = None, np.full(3, np.inf)
    returns = ghosts = 0
    for moment in track(played, "playing back", total=drive.scans):
        album.add(moment)
        returns, ghosts = returns + len(moment.ghosts), ghosts + int(moment.ghosts.sum())
        if not np.linalg.norm(moment.vehicle - before) < MOSAIC_METRES:
            before = moment.vehicle.copy()
            mosaic.add(moment.layers)
        if recorder is not None:
            recorder.add(moment, log.poses.at(np.array([moment.time]))[0])
    if moment is None:
        raise LogError("no scan in that stretch whose pose is known", where=log.path, how="change --seconds")
    mosaic.add(moment.layers)
    if recorder is not None:
        recorder.add_map(moment)
    pits = int(find_pits(moment.layers.elevation).sum())
    logger.info(
        f"  {ghosts / max(returns, 1):.3%} of the returns below the ground left out; {pits} pits in the last map"
    )
    return moment


def _blind(pixels: np.ndarray) -> np.ndarray:
    """No features."""
    return np.zeros((1, 1, 0), np.float32)


def _write_album(album: Album, out: Path) -> list[Path]:
    """A line a moment, a column a camera; moments side by side where there is one camera."""
    written = []
    side_by_side = album.cameras if album.cameras > 1 else 2
    for name, pictures, columns in (("overlay", album.overlays, side_by_side), ("features", album.besides, 1)):
        if pictures:
            written.append(out / f"{name}.png")
            write_png(written[-1], contact_sheet(pictures, columns))
    return written


def _write_maps(drive: _Drive, mosaic: Mosaic, last: Moment, out: Path) -> list[Path]:
    ground, wheels = mosaic.ground(), drive.wheels[..., :2]
    middle = drive.wheels[len(drive.wheels) // 2, :, :2].mean(axis=0)
    here = middle if np.isfinite(middle).all() else last.vehicle[:2]
    figures: dict[str, Figure] = {
        "map": draw_map(ground.trimmed(), wheels, drive.limits, title=f"{drive.log.path.name}: all ground seen"),
        "map-near": draw_map(
            ground.cropped(here - NEAR, here + NEAR), wheels, drive.limits, title="halfway, as it was held last"
        ),
    }
    for name, figure in figures.items():
        write_bytes(out / f"{name}.png", png(figure))
    return [out / f"{name}.png" for name in figures]
