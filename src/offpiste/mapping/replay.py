"""A drive's sensors played back in the order of time: images to features, scans to the map, as on the vehicle."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from offpiste.logs.measurements import Cloud, Image
from offpiste.logs.sensors import SensorLog
from offpiste.mapping.layers import TerrainLayers
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.perception.cameras import PinholeCamera, make_pinhole_camera
from offpiste.perception.carry import points_in_world
from offpiste.perception.projection import Projection, ProjectionSettings, View, project

Look = Callable[[UInt8[np.ndarray, "h w 3"]], Float32[np.ndarray, "rows columns F"]]
"""From a rectified image to the features of its patches."""


@dataclass(frozen=True)
class ReplaySettings:
    """How a drive is played back.

    Attributes:
        frame_metres: an image is looked at when the vehicle has gone so far since the camera's last one [m].
        memory: older images than this are not projected onto [s].
        projection, map: of those stages.
    """

    frame_metres: float = 0.5
    memory: float = 1.0
    projection: ProjectionSettings = field(default_factory=ProjectionSettings)
    map: MapSettings = field(default_factory=MapSettings)


@dataclass(frozen=True)
class Moment:
    """The map right after a scan.

    Attributes:
        time: of the scan [s].
        vehicle: place of the pose point then [m].
        layers: of the map; written over by the next scan.
        points_world, projection: the scan itself, and where the images of `views` show it.
        looks: features of these images.
        images: they themselves, rectified.
    """

    time: float
    vehicle: Float[np.ndarray, " 3"]
    layers: TerrainLayers
    points_world: Float[np.ndarray, "n 3"]
    projection: Projection | None
    views: tuple[View, ...]
    looks: tuple[Float32[np.ndarray, "_ _ F"], ...]
    images: tuple[UInt8[np.ndarray, "_ _ 3"], ...]


class _Seen(NamedTuple):
    """The last image of a camera that was looked at."""

    view: View
    features: Float32[np.ndarray, "rows columns F"]
    pixels: UInt8[np.ndarray, "h w 3"]


def pinhole_cameras(log: SensorLog, patch: int) -> dict[str, PinholeCamera]:
    """The cameras of a log, rectified, in patches of `patch` pixels."""
    return {name: make_pinhole_camera(camera, patch) for name, camera in log.cameras.items()}


def replay(
    log: SensorLog,
    cameras: dict[str, PinholeCamera],
    look: Look,
    channels: int,
    settings: ReplaySettings | None = None,
    *,
    wanted: Callable[[Image], bool] | None = None,
    start: float = -np.inf,
    end: float = np.inf,
) -> Iterator[Moment]:
    """Play a drive back; where poses jump, the map begins anew.

    Args:
        cameras: those that are looked through.
        look: backbone and PCA.
        channels: F of its features; 0 maps the scans alone.
        wanted: images that are looked at, instead of one every `frame_metres`.
        start, end: of the stretch that is played [s].
    """
    settings = settings or ReplaySettings()
    pipeline, layers, stretch = MapPipeline(channels, settings.map), None, 0
    latest: dict[str, _Seen] = {}
    for measured in log.stream([*cameras, *log.lidars], start=start, end=end):
        pose = log.poses.at(np.array([measured.time]))[0]
        if np.isnan(pose).any():
            continue
        if log.poses.stretch(measured.time) != stretch:
            stretch = log.poses.stretch(measured.time)
            pipeline, layers, latest = MapPipeline(channels, settings.map), None, {}
        if isinstance(measured, Image):
            if _is_due(measured, pose, latest, settings) if wanted is None else wanted(measured):
                camera = cameras[measured.camera]
                view = View(camera, measured.time, pose @ camera.body_from_camera)
                pixels = camera.rectifier(measured.pixels)
                latest[measured.camera] = _Seen(view, look(pixels), pixels)
            continue
        seen = [entry for entry in latest.values() if measured.time - entry.view.time <= settings.memory]
        views, looks = tuple(entry.view for entry in seen), tuple(entry.features for entry in seen)
        points, cloud, projection = _feature_cloud(log, measured, views, looks if channels else (), settings)
        pipeline.add(cloud, pose[:3, 3])
        layers = pipeline.layers(layers)
        images = tuple(entry.pixels for entry in seen)
        yield Moment(measured.time, pose[:3, 3], layers, points, projection, views, looks, images)


def ground_points(moment: Moment, *, height: float = 0.2) -> Bool[np.ndarray, " n"]:
    """Points of a scan that lie on the map's ground.

    Args:
        height: above or below it [m].
    """
    layers = moment.layers
    cell = np.round((np.nan_to_num(moment.points_world[:, :2]) - layers.origin) / layers.resolution).astype(int)
    ny, nx = layers.elevation.shape
    inside = ((cell >= 0) & (cell < [nx, ny])).all(axis=1) & np.isfinite(moment.points_world).all(axis=1)
    column, row = np.where(inside[:, None], cell, 0).T
    with np.errstate(invalid="ignore"):
        near = np.abs(moment.points_world[:, 2] - layers.elevation[row, column]) <= height
    return np.asarray(inside & near)


def _is_due(image: Image, pose: Float[np.ndarray, "4 4"], latest: dict[str, _Seen], settings: ReplaySettings) -> bool:
    if image.camera not in latest:
        return True
    before = latest[image.camera].view
    here = (pose @ before.camera.body_from_camera)[:3, 3]
    moved = np.linalg.norm(here - before.world_from_camera[:3, 3])
    return bool(moved >= settings.frame_metres or image.time - before.time > settings.memory)


def _feature_cloud(
    log: SensorLog, scan: Cloud, views: tuple[View, ...], looks: tuple[np.ndarray, ...], settings: ReplaySettings
) -> tuple[Float[np.ndarray, "n 3"], FeatureCloud, Projection | None]:
    lidar = log.lidars[scan.lidar]
    points = points_in_world(scan, lidar, log.poses)
    points = points[np.isfinite(points).all(axis=1)]
    sensor = (log.poses.at(np.array([scan.time]))[0] @ lidar.body_from_lidar)[:3, 3]
    if not views:
        return points, FeatureCloud(points, sensor), None
    projection = project(points, views, settings.projection)
    if not looks:
        return points, FeatureCloud(points, sensor), projection
    features = projection.gather(looks).astype(np.float32)
    return points, FeatureCloud(points, sensor, features, projection.seen), projection
