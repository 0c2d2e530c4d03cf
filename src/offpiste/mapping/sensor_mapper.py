"""Images and scans in, in the order of their times; the map out: the same on the vehicle and on a recorded log."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8

from offpiste.logs.measurements import Cloud, Image, Lidar
from offpiste.logs.poses import Poses
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.perception.camera import PinholeCamera
from offpiste.perception.motion_compensation import points_in_world
from offpiste.perception.projection import CameraView, Projection, ProjectionSettings, project

ExtractFeatures = Callable[[UInt8[np.ndarray, "h w 3"]], Float32[np.ndarray, "rows columns F"]]
"""From a rectified image to the features of its patches."""


@dataclass(frozen=True)
class MapperSettings:
    """Which images are used, how scans are projected onto them, and the map.

    Attributes:
        keyframe_metres: features are extracted from an image when the vehicle has gone so far since the camera's last
            keyframe [m].
        memory: keyframes older than this are not projected onto [s].
    """

    keyframe_metres: float = 0.5
    memory: float = 1.0
    projection: ProjectionSettings = field(default_factory=ProjectionSettings)
    map: MapSettings = field(default_factory=MapSettings)


class Keyframe(NamedTuple):
    """An image from which features were extracted.

    Attributes:
        view: where the camera was.
        features: of its patches.
        pixels: rectified.
    """

    view: CameraView
    features: Float32[np.ndarray, "rows columns F"]
    pixels: UInt8[np.ndarray, "h w 3"]


class MappedScan(NamedTuple):
    """A scan as it went into the map, and the keyframes that it was projected onto, if there were any."""

    points_world: Float[np.ndarray, "n 3"]
    projection: Projection | None
    keyframes: tuple[Keyframe, ...]


class SensorMapper:
    """The map around a vehicle, from its images and scans.

    Args:
        cameras: whose images are used.
        lidars: of the scans.
        extract: backbone and PCA; on the vehicle, the encoder too.
        channels: of the features; 0 maps the scans alone.
    """

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
        self._keyframes: dict[str, Keyframe] = {}
        self.pipeline = MapPipeline(channels, self._settings.map)

    def is_keyframe(self, image: Image, pose: Float[np.ndarray, "4 4"]) -> bool:
        """Whether the vehicle has gone far enough since the camera's last keyframe.

        Args:
            pose: `world_from_body` at the image's time.
        """
        if image.camera not in self._keyframes:
            return True
        before = self._keyframes[image.camera].view
        here = (pose @ before.camera.body_from_camera)[:3, 3]
        moved = np.linalg.norm(here - before.world_from_camera[:3, 3])
        return bool(moved >= self._settings.keyframe_metres or image.time - before.time > self._settings.memory)

    def add_image(self, image: Image, pose: Float[np.ndarray, "4 4"]) -> None:
        """Make an image the camera's keyframe: scans that follow get its features.

        Args:
            pose: `world_from_body` at its time.
        """
        camera = self._cameras[image.camera]
        view = CameraView(camera, image.time, pose @ camera.body_from_camera)
        pixels = camera.rectifier(image.pixels)
        self._keyframes[image.camera] = Keyframe(view, self._extract(pixels), pixels)

    def add_scan(self, scan: Cloud, poses: Poses, pose: Float[np.ndarray, "4 4"]) -> MappedScan:
        """Put a scan into the map.

        Args:
            poses: over the whole scan; points at unknown ones are left out.
            pose: `world_from_body` at its time.
        """
        recent = tuple(k for k in self._keyframes.values() if scan.time - k.view.time <= self._settings.memory)
        lidar = self._lidars[scan.lidar]
        points = points_in_world(scan, lidar, poses)
        points = points[np.isfinite(points).all(axis=1)]
        cloud, projection = FeatureCloud(points, (pose @ lidar.body_from_lidar)[:3, 3]), None
        if recent:
            projection = project(points, [k.view for k in recent], self._settings.projection)
        if projection is not None and self._channels:
            features = projection.gather([k.features for k in recent]).astype(np.float32)
            cloud = replace(cloud, features=features, has_feature=projection.seen)
        self.pipeline.add(cloud, pose[:3, 3])
        return MappedScan(points, projection, recent)
