"""Pictures and a Rerun recording of a recorded drive: sensors and map."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

from offpiste.calibration.map_health import find_pits, map_health
from offpiste.calibration.samples import gather
from offpiste.core.errors import LogError, RigError, installation_of, is_installed
from offpiste.core.progress import track
from offpiste.inspection.sensors import check_map_health
from offpiste.logs.log import Log
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.mapping.replay import MapperSettings, Moment, pinhole_cameras, replay
from offpiste.mapping.terrain_map import wheel_positions
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.report.figure import BLUE, GREEN, ORANGE, plain, write_png
from offpiste.rig.rig import Rig
from offpiste.visualization.images import Album, contact_sheet, times_between, write_image
from offpiste.visualization.map_figure import FEATURED, Mosaic, draw_map
from offpiste.visualization.rerun_recording import Recorder

logger = logging.getLogger(__name__)

PATCH = 14
"""Side of a patch without features [px]."""

PATH_STEP = 0.1
"""Time between points of the wheels' tracks [s]."""

EARLIER = 1.0
"""Time before the first scan from which images are processed [s]."""

MOSAIC_METRES = 2.0
"""Distance driven between updates of the mosaic [m]."""

NEAR = 25.0
"""Half the side of the detailed map [m]."""

LONG = 3.0
"""Shortest gap between messages, in usual intervals."""


@dataclass(frozen=True)
class _Drive:
    """Interval of a drive to play back.

    Attributes:
        start, end: first and last scan of the interval [s].
        scans: number of scans.
        limits: colours of the features; None without features.
        path: positions of the pose point every `PATH_STEP` [m]; NaN if unknown.
        wheels: positions of the wheels at the same times, at the height of the pose point [m].
    """

    log: SensorLog
    extractor: FeatureExtractor | None
    start: float
    end: float
    scans: int
    limits: Float[np.ndarray, "2 3"] | None
    path: Float[np.ndarray, "N 3"]
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
        extractor: extractor of image features; None for none.
        stretch: start and end time after the first pose [s].
        rrd: whether to write drive.rrd; skipped with a message where rerun-sdk is missing.

    Returns:
        Paths of the files written, each atomically.

    Raises:
        LogError, RigError: the interval has no data that can be viewed with this rig.
    """
    drive = _open(log, rig, extractor, stretch)
    sensors = drive.log
    for note in (*sensors.notes, *sensors.coverage()):
        logger.info(f"  {note}")
    if rrd and not is_installed("rerun"):
        how = installation_of("view")
        logger.info(f"no recording, since rerun-sdk is not installed ({how}); writing pictures only")
        rrd = False
    written = [out / "sensors.png", *([out / "drive.rrd"] if rrd else [])]
    write_png(written[0], draw_sensors(stamps_of(sensors), stretch))
    health = map_health(sensors.lidars, gather(sensors, {}), sensors.poses)
    logger.info(f"  first minute: {health}")
    for finding in check_map_health(health):
        logger.info(f"  {finding.severity}: {finding.where}: {finding.what}; {finding.remedy}")
    voxels, places = MapperSettings().map.voxels, drive.path[:, :2]
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    mosaic = Mosaic(low - voxels.reach - 1, high + voxels.reach + 1, voxels.size)
    album = Album(times_between(drive.start, drive.end), drive.limits, len(sensors.cameras))
    with _recording(drive, out / "drive.rrd" if rrd else None) as recorder:
        last = _play(drive, mosaic, album, recorder)
    columns = album.cameras if album.cameras > 1 else 2  # a column for each camera, or moments side by side
    for name, pictures, side_by_side in (("overlay", album.overlays, columns), ("features", album.besides, 1)):
        if pictures:
            written.append(out / f"{name}.png")
            write_image(written[-1], contact_sheet(pictures, side_by_side))
    middle = drive.wheels[len(drive.wheels) // 2, :, :2].mean(axis=0)
    here = middle if np.isfinite(middle).all() else last.vehicle[:2]
    near, wheels = mosaic.ground.cropped(here - NEAR, here + NEAR), drive.wheels[..., :2]
    for name, ground, title in (
        ("map", mosaic.ground.trimmed(), f"{sensors.path.name}: all observed ground"),
        ("map-near", near, "around the middle of the drive"),
    ):
        written.append(out / f"{name}.png")
        write_png(written[-1], draw_map(ground, wheels, drive.limits, title=title))
    known = mosaic.ground.known[mosaic.ground.known > 0]
    logger.info(
        f"{drive.end - drive.start:.1f} s; {len(known) * mosaic.ground.resolution**2:.0f} m² of ground, "
        f"{(known == FEATURED).sum() / max(len(known), 1):.0%} of it with features"
    )
    return written


def _open(log: Log, rig: Rig, extractor: FeatureExtractor | None, stretch: tuple[float, float]) -> _Drive:
    if not rig.lidars and not rig.cameras:
        raise RigError(
            f"rig '{rig.name}' has neither cameras nor LiDARs to view",
            where=log.path,
            how="add [cameras.NAME] and [lidars.NAME] (docs/rig.md); `offpiste inspect` shows the other channels",
        )
    sensors = open_sensors(log, rig)
    if not sensors.lidars:
        raise LogError(
            f"has cameras ({', '.join(sensors.cameras)}) but no LiDAR, which a map requires",
            where=log.path,
            how="record a LiDAR too, or add it to the rig",
        )
    first, last = sensors.poses.span
    scans = np.concatenate([sensors.stamps(name) for name in sensors.lidars])
    scans = scans[(scans >= first + stretch[0]) & (scans <= min(last, first + stretch[1]))]
    if not len(scans):
        what = f"no scan from {stretch[0]:g} to {stretch[1]:g} s; its poses cover {last - first:.1f} s"
        raise LogError(what, where=log.path, how="change --seconds")
    start, end = float(scans.min()), float(scans.max())
    poses = sensors.poses.at(np.append(np.arange(start, end, PATH_STEP), end))
    if not np.isfinite(poses).all(axis=(1, 2)).any():
        raise LogError("no pose in that interval", where=log.path, how="change --seconds")
    limits = None
    if extractor is not None:  # two standard deviations of the first three components; missing ones do not vary
        spread = 2 * np.sqrt(extractor.pca.variance[:3].astype(np.float64))
        limits = np.pad(np.stack((-spread, spread)), ((0, 0), (0, 3 - len(spread))))
    path = poses[:, :3, 3]
    wheels = wheel_positions(path[:, :2], np.arctan2(poses[:, 1, 0], poses[:, 0, 0]), rig.wheel_positions())
    wheels = np.concatenate((wheels, np.repeat(path[:, None, 2:], 4, axis=1)), axis=2)
    return _Drive(sensors, extractor, start, end, len(scans), limits, path, wheels)


@contextmanager
def _recording(drive: _Drive, path: Path | None) -> Iterator[Recorder | None]:
    """Yield a recorder whose file is kept only on success."""
    if path is None:
        yield None
        return
    partial = path.with_name(f".{path.name}.partial.rrd")
    path.parent.mkdir(parents=True, exist_ok=True)
    origin = drive.path[np.isfinite(drive.path).all(axis=1)][0]
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
    """Play the drive back into the pictures and the recording, and return the last moment."""
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
        raise LogError("no scan in that interval has a pose", where=log.path, how="change --seconds")
    mosaic.add(moment.layers)
    if recorder is not None:
        recorder.add_map(moment)
    pits, share = int(find_pits(moment.layers.elevation).sum()), ghosts / max(returns, 1)
    logger.info(f"  removed {share:.3%} of the returns, below the ground; {pits} pits in the last map")
    return moment


def _blind(pixels: np.ndarray) -> np.ndarray:
    """Return no features."""
    return np.zeros((1, 1, 0), np.float32)


def stamps_of(log: SensorLog) -> dict[str, Float[np.ndarray, " _"]]:
    """Return the sorted times of poses, cameras and LiDARs, after the first pose [s]."""
    first = log.poses.span[0]
    result = {"poses": log.poses.position.time, **{name: log.stamps(name) for name in (*log.cameras, *log.lidars)}}
    return {name: np.sort(time) - first for name, time in result.items()}


def gaps(time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " _"]:
    """Return a mask of the n - 1 intervals between messages that are gaps: longer than three usual intervals."""
    steps = np.diff(time)
    return steps > LONG * np.median(steps) if len(steps) else np.zeros(0, bool)


def draw_sensors(stamps: Mapping[str, Float[np.ndarray, " _"]], stretch: tuple[float, float]) -> Figure:
    """Draw the times of each sensor's messages, and the intervals between them.

    Args:
        stamps: sorted times of each sensor [s].
        stretch: viewed interval of the log, which is marked; its end may be infinite [s].
    """
    figure = Figure(figsize=(12, 2.6 + 0.34 * len(stamps) + 1.6), dpi=120, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(0.5 + 0.34 * len(stamps), 2.6))
    plain(above, "messages of each sensor; orange: gaps of more than three usual intervals")
    plain(below, "time between messages")
    for line, (name, time) in enumerate(stamps.items()):
        steps, gap = np.diff(time), gaps(time)
        colour = GREEN if name == "poses" else BLUE
        begins, ends = time[:-1][~gap], time[1:][~gap]
        above.hlines(np.full(len(begins), line), begins, ends, color=colour, linewidth=7)
        above.hlines(np.full(int(gap.sum()), line), time[:-1][gap], time[1:][gap], color=ORANGE, linewidth=3)
        below.plot(time[1:], steps, ".", markersize=3, label=_described(name, time), alpha=0.6)
    last = max((float(time[-1]) for time in stamps.values() if len(time)), default=1.0)
    for axes in (above, below):
        axes.axvspan(stretch[0], min(stretch[1], last), color=BLUE, alpha=0.06)
    above.set_yticks(range(len(stamps)), list(stamps))
    above.set_ylim(len(stamps) - 0.5, -0.5)
    below.set(xlabel="time after the first pose [s]", ylabel="[s]", yscale="log")
    below.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    below.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    below.yaxis.set_minor_locator(NullLocator())
    below.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _described(name: str, time: Float[np.ndarray, " n"]) -> str:
    if len(time) < 2:
        return f"{name}: {len(time)} messages"
    count = int(gaps(time).sum())
    return f"{name}: {len(time)}, {1 / np.median(np.diff(time)):.1f} Hz" + (f", {count} gaps" if count else "")
