"""A drive's sensors played back in the order of time: images to features, scans to the map, as on the vehicle."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from offpiste.logs.measurements import Cloud, Image, Lidar
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.perception.camera import PinholeCamera, make_pinhole_camera
from offpiste.perception.motion_compensation import points_in_world
from offpiste.perception.projection import CameraView, Projection, ProjectionSettings, project

ExtractFeatures = Callable[[UInt8[np.ndarray, "h w 3"]], Float32[np.ndarray, "rows columns F"]]
"""From a rectified image to the features of its patches."""


@dataclass(frozen=True)
class ReplaySettings:
    """How a drive is played back.

    Attributes:
        keyframe_metres: distance that the vehicle travels between two keyframes of a camera [m].
        memory: older images than this are not projected onto [s].
        projection, map: settings of those stages.
    """

    keyframe_metres: float = 0.5
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
        points_world, projection: the scan itself, and the places of its points in the images of `views`.
        features: of these images.
        images: these images, rectified.
    """

    time: float
    vehicle: Float[np.ndarray, " 3"]
    layers: TerrainLayers
    points_world: Float[np.ndarray, "n 3"]
    projection: Projection | None
    views: tuple[CameraView, ...]
    features: tuple[Float32[np.ndarray, "_ _ F"], ...]
    images: tuple[UInt8[np.ndarray, "_ _ 3"], ...]


class _Seen(NamedTuple):
    """Last keyframe of a camera."""

    view: CameraView
    features: Float32[np.ndarray, "rows columns F"]
    pixels: UInt8[np.ndarray, "h w 3"]


class Scanned(NamedTuple):
    """A scan as it went into the map, and the images that were projected onto it (see `Moment`)."""

    points_world: Float[np.ndarray, "n 3"]
    projection: Projection | None
    seen: tuple[_Seen, ...]


class Mapper:
    """Images and scans in, in the order of their times; the map out: the same on the vehicle and on a log.

    Args:
        cameras: those in use, by name.
        lidars: of the scans.
        extract: backbone and PCA; on the vehicle, the encoder too.
        channels: features that `extract` gives; 0 maps the scans alone.
    """

    def __init__(
        self,
        cameras: Mapping[str, PinholeCamera],
        lidars: Mapping[str, Lidar],
        extract: ExtractFeatures,
        channels: int,
        settings: ReplaySettings | None = None,
    ) -> None:
        self._settings = settings or ReplaySettings()
        self._cameras, self._lidars, self._extract, self._channels = cameras, lidars, extract, channels
        self._latest: dict[str, _Seen] = {}
        self.pipeline = MapPipeline(channels, self._settings.map)

    def is_due(self, image: Image, pose: Float[np.ndarray, "4 4"]) -> bool:
        """Whether the vehicle has gone far enough since the camera's last image.

        Args:
            pose: `world_from_body` at the image's time.
        """
        if image.camera not in self._latest:
            return True
        before = self._latest[image.camera].view
        here = (pose @ before.camera.body_from_camera)[:3, 3]
        moved = np.linalg.norm(here - before.world_from_camera[:3, 3])
        return bool(moved >= self._settings.keyframe_metres or image.time - before.time > self._settings.memory)

    def add_image(self, image: Image, pose: Float[np.ndarray, "4 4"]) -> None:
        """Extract the features of a keyframe; scans that follow get them."""
        camera = self._cameras[image.camera]
        view = CameraView(camera, image.time, pose @ camera.body_from_camera)
        pixels = camera.rectifier(image.pixels)
        self._latest[image.camera] = _Seen(view, self._extract(pixels), pixels)

    def add_scan(self, scan: Cloud, poses: Poses, pose: Float[np.ndarray, "4 4"]) -> Scanned:
        """Put a scan into the map.

        Args:
            poses: over the whole scan; points at unknown ones are left out.
            pose: `world_from_body` at its time.
        """
        seen = tuple(s for s in self._latest.values() if scan.time - s.view.time <= self._settings.memory)
        lidar = self._lidars[scan.lidar]
        points = points_in_world(scan, lidar, poses)
        points = points[np.isfinite(points).all(axis=1)]
        cloud, projection = FeatureCloud(points, (pose @ lidar.body_from_lidar)[:3, 3]), None
        if seen:
            projection = project(points, [s.view for s in seen], self._settings.projection)
        if projection is not None and self._channels:
            features = projection.gather([s.features for s in seen]).astype(np.float32)
            cloud = replace(cloud, features=features, has_feature=projection.seen)
        self.pipeline.add(cloud, pose[:3, 3])
        return Scanned(points, projection, seen)


def pinhole_cameras(log: SensorLog, patch: int) -> dict[str, PinholeCamera]:
    """The cameras of a log, rectified, in patches of `patch` pixels."""
    return {name: make_pinhole_camera(camera, patch) for name, camera in log.cameras.items()}


def replay(
    log: SensorLog,
    cameras: dict[str, PinholeCamera],
    extract: ExtractFeatures,
    channels: int,
    settings: ReplaySettings | None = None,
    *,
    wanted: Callable[[Image], bool] | None = None,
    start: float = -np.inf,
    end: float = np.inf,
) -> Iterator[Moment]:
    """Play a drive back; where poses jump, the map begins anew.

    Args:
        cameras: those in use, by name.
        extract: backbone and PCA.
        channels: F, number of its features; 0 maps the scans alone.
        wanted: chooses the keyframes, instead of one every `keyframe_metres`.
        start, end: of the stretch that is played back [s].
    """
    mapper, layers, stretch = Mapper(cameras, log.lidars, extract, channels, settings), None, 0
    for measured in log.stream([*cameras, *log.lidars], start=start, end=end):
        pose = log.poses.at(np.array([measured.time]))[0]
        if np.isnan(pose).any():
            continue
        if log.poses.stretch(measured.time) != stretch:
            stretch = log.poses.stretch(measured.time)
            mapper, layers = Mapper(cameras, log.lidars, extract, channels, settings), None
        if isinstance(measured, Image):
            if mapper.is_due(measured, pose) if wanted is None else wanted(measured):
                mapper.add_image(measured, pose)
            continue
        points, projection, seen = mapper.add_scan(measured, log.poses, pose)
        layers = mapper.pipeline.layers(layers)
        views, features = tuple(s.view for s in seen), tuple(s.features for s in seen)
        images = tuple(s.pixels for s in seen)
        yield Moment(measured.time, pose[:3, 3], layers, points, projection, views, features, images)


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
