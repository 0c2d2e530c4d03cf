"""Replay of a drive's sensors into the map, as on the vehicle: images to features, scans to voxels."""

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from offpiste.logs.measurements import Cloud, Image, Lidar
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.perception.camera import PinholeCamera, make_pinhole_camera
from offpiste.perception.motion_compensation import MOMENT, points_in_world
from offpiste.perception.projection import CameraView, Projection, ProjectionSettings, project

logger = logging.getLogger(__name__)

ExtractFeatures = Callable[[UInt8[np.ndarray, "h w 3"]], Float32[np.ndarray, "rows columns F"]]
"""Extractor of patch features from a rectified image: backbone and PCA, and the encoder on the vehicle."""


@dataclass(frozen=True)
class MapperSettings:
    """Settings of keyframes, of the projection of scans onto them, and of the map."""

    keyframe_metres: float = 0.5  # travel of the camera between keyframes [m]
    memory: float = 1.0  # maximum age of keyframes that scans are projected onto [s]
    projection: ProjectionSettings = field(default_factory=ProjectionSettings)
    map: MapSettings = field(default_factory=MapSettings)


class Keyframe(NamedTuple):
    """Rectified image with the camera's pose and the features of its patches."""

    view: CameraView
    features: Float32[np.ndarray, "rows columns F"]
    pixels: UInt8[np.ndarray, "h w 3"]


class MappedScan(NamedTuple):
    """Mapped scan, and the keyframes that it was projected onto."""

    points_world: Float[np.ndarray, "n 3"]  # points at known poses [m]
    measured: float  # time of the last point, or the scan's stamp if later [s]
    ghosts: Bool[np.ndarray, " n"]  # mask of points left out of the map (`mapping.ghosts`)
    projection: Projection | None
    keyframes: tuple[Keyframe, ...]


class Keyframes:
    """Last keyframe of each camera."""

    def __init__(self, cameras: Mapping[str, PinholeCamera], settings: MapperSettings) -> None:
        self._cameras, self._settings = cameras, settings
        self._held: dict[str, Keyframe] = {}

    def due(self, image: Image, pose: Float[np.ndarray, "4 4"]) -> bool:
        """Return whether an image at pose `world_from_body` becomes a keyframe, by travel or time since the last."""
        if image.camera not in self._held:
            return True
        before = self._held[image.camera].view
        here = (pose @ before.camera.body_from_camera)[:3, 3]
        moved = np.linalg.norm(here - before.world_from_camera[:3, 3])
        return bool(moved >= self._settings.keyframe_metres or image.time - before.time > self._settings.memory)

    def add(
        self,
        camera: str,
        time: float,
        pose: Float[np.ndarray, "4 4"],
        features: Float32[np.ndarray, "rows columns F"],
        pixels: UInt8[np.ndarray, "h w 3"],
    ) -> None:
        """Make an image with pose `world_from_body` the camera's keyframe."""
        view = CameraView(self._cameras[camera], time, pose @ self._cameras[camera].body_from_camera)
        self._held[camera] = Keyframe(view, features, pixels)

    def recent(self, time: float) -> tuple[Keyframe, ...]:
        """Return the keyframes that scans at a time are projected onto."""
        return tuple(k for k in self._held.values() if time - k.view.time <= self._settings.memory)


class SensorMapper:
    """Map around a vehicle, built from its images and scans; with 0 channels, from scans alone."""

    def __init__(
        self,
        cameras: Mapping[str, PinholeCamera],
        lidars: Mapping[str, Lidar],
        extract: ExtractFeatures,
        channels: int,
        settings: MapperSettings | None = None,
    ) -> None:
        self._settings = settings or MapperSettings()
        self._cameras, self._lidars = cameras, lidars
        self._extract, self._channels = extract, channels
        self.keyframes = Keyframes(cameras, self._settings)
        self.pipeline = MapPipeline(channels, self._settings.map)
        self._full = False

    def add_image(self, image: Image, pose: Float[np.ndarray, "4 4"]) -> None:
        """Make an image the camera's keyframe, whose features are used for the scans that follow."""
        pixels = self._cameras[image.camera].rectifier(image.pixels)
        self.keyframes.add(image.camera, image.time, pose, self._extract(pixels), pixels)

    def add_scan(self, scan: Cloud, poses: Poses, pose: Float[np.ndarray, "4 4"]) -> MappedScan:
        """Insert a scan at pose `world_from_body`, without points at unknown `poses` or across a jump of them."""
        recent = self.keyframes.recent(scan.time)
        lidar = self._lidars[scan.lidar]
        points = points_in_world(scan, lidar, poses)
        known = np.isfinite(points[:, 0] + points[:, 1] + points[:, 2])
        if len(poses.jumps):  # points across a jump are in another frame
            known &= poses.stretches(scan.times) == poses.stretch(scan.time)
        points, measured = points if known.all() else points[known], float(scan.times[known].max(initial=scan.time))
        cloud, projection = FeatureCloud(points, (pose @ lidar.body_from_lidar)[:3, 3]), None
        if recent:
            projection = project(points, [k.view for k in recent], self._settings.projection)
        if projection is not None and self._channels:
            features = projection.gather([k.features for k in recent]).astype(np.float32, copy=False)
            cloud = replace(cloud, features=features, has_feature=projection.seen)
        ghosts = self.pipeline.add(cloud, pose[:3, 3])
        if not self._full and self.pipeline.voxel_map.lost:
            self._full = True
            logger.warning("the map is full and new voxels ahead are lost: raise VoxelSettings.capacity")
        return MappedScan(points, measured, ghosts, projection, recent)


@dataclass(frozen=True)
class Moment:
    """Map right after a scan, valid until the next scan."""

    time: float  # stamp of the scan [s]
    measured: float  # time of the last measurement in the map [s]
    placed: float  # stamp of the last pose used for a measurement in the map [s]
    vehicle: Float[np.ndarray, " 3"]  # position of the pose point at `time` [m]
    map: MapPipeline
    # layers of an earlier moment of the same map, to be overwritten; None for the first
    layers_before: TerrainLayers | None
    points_world: Float[np.ndarray, "n 3"]  # points of the scan [m]
    ghosts: Bool[np.ndarray, " n"]  # mask of points left out of the map (`mapping.ghosts`)
    projection: Projection | None  # projection of the scan into the camera views; None without any
    views: tuple[CameraView, ...]  # of the keyframes used
    features: tuple[Float32[np.ndarray, "_ _ F"], ...]  # of their patches
    images: tuple[UInt8[np.ndarray, "_ _ 3"], ...]  # rectified

    @cached_property
    def layers(self) -> TerrainLayers:
        """Layers of the map, computed on first access."""
        return self.map.layers(self.layers_before)


def pinhole_cameras(log: SensorLog, patch: int) -> dict[str, PinholeCamera]:
    """Return the rectified cameras of a log, with patches of `patch` pixels."""
    return {name: make_pinhole_camera(camera, patch) for name, camera in log.cameras.items()}


def replay(
    log: SensorLog,
    cameras: dict[str, PinholeCamera],
    extract: ExtractFeatures,
    channels: int,
    settings: MapperSettings | None = None,
    *,
    wanted: Callable[[Image], bool] | None = None,
    start: float = -np.inf,
    end: float = np.inf,
) -> Iterator[Moment]:
    """Replay a log and yield the map after each scan; the map is reset where poses jump.

    Args:
        channels: number of features; 0 maps scans without images.
        wanted: selection of keyframes instead of one every `keyframe_metres`.
        start, end: time range to replay [s].
    """

    def new_mapper() -> SensorMapper:
        return SensorMapper(cameras, log.lidars, extract, channels, settings)

    mapper, layers, stretch, measured_until = new_mapper(), None, 0, -np.inf
    for measured in log.stream([*cameras, *log.lidars], start=start, end=end):
        pose = log.poses.at(np.array([measured.time]))[0]
        if np.isnan(pose).any():
            continue
        if log.poses.stretch(measured.time) != stretch:
            stretch = log.poses.stretch(measured.time)
            mapper, layers = new_mapper(), None
        if isinstance(measured, Image):
            if mapper.keyframes.due(measured, pose) if wanted is None else wanted(measured):
                mapper.add_image(measured, pose)
            continue
        points, last, ghosts, projection, keyframes = mapper.add_scan(measured, log.poses, pose)
        measured_until = max(measured_until, last)
        moment = Moment(
            time=measured.time,
            measured=measured_until,
            placed=log.poses.known(measured_until + MOMENT),
            vehicle=pose[:3, 3],
            map=mapper.pipeline,
            layers_before=layers,
            points_world=points,
            ghosts=ghosts,
            projection=projection,
            views=tuple(k.view for k in keyframes),
            features=tuple(k.features for k in keyframes),
            images=tuple(k.pixels for k in keyframes),
        )
        yield moment
        layers = vars(moment).get("layers", layers)  # reuse their memory


def ground_points(moment: Moment, *, height: float = 0.2) -> Bool[np.ndarray, " n"]:
    """Return the mask of a scan's points within `height` [m] of the map's ground."""
    layers = moment.layers
    cell = np.round((np.nan_to_num(moment.points_world[:, :2]) - layers.origin) / layers.resolution).astype(int)
    ny, nx = layers.elevation.shape
    inside = ((cell >= 0) & (cell < [nx, ny])).all(axis=1) & np.isfinite(moment.points_world).all(axis=1)
    column, row = np.where(inside[:, None], cell, 0).T
    with np.errstate(invalid="ignore"):
        near = np.abs(moment.points_world[:, 2] - layers.elevation[row, column]) <= height
    return np.asarray(inside & near)
