"""A log's sensors played back in the order of time, as on the vehicle: images to features, scans to the map."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from offpiste.logs.measurements import Image
from offpiste.logs.sensor_log import SensorLog
from offpiste.mapping.sensor_mapper import ExtractFeatures, MapperSettings, SensorMapper
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.perception.camera import PinholeCamera, make_pinhole_camera
from offpiste.perception.projection import CameraView, Projection


@dataclass(frozen=True)
class Moment:
    """The map right after a scan.

    Attributes:
        time: of the scan [s].
        vehicle: place of the pose point then [m].
        layers: of the map; written over by the next scan.
        points_world: the scan itself [m].
        projection: the scan in the camera views; None without any.
        views: camera views of the keyframes that it was projected onto.
        features: of their patches.
        images: their pixels, rectified.
    """

    time: float
    vehicle: Float[np.ndarray, " 3"]
    layers: TerrainLayers
    points_world: Float[np.ndarray, "n 3"]
    projection: Projection | None
    views: tuple[CameraView, ...]
    features: tuple[Float32[np.ndarray, "_ _ F"], ...]
    images: tuple[UInt8[np.ndarray, "_ _ 3"], ...]


def pinhole_cameras(log: SensorLog, patch: int) -> dict[str, PinholeCamera]:
    """The cameras of a log, rectified, in patches of `patch` pixels."""
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
    """Play a log back; where poses jump, the map begins anew.

    Args:
        cameras: whose images are used.
        extract: backbone and PCA.
        channels: F of its features; 0 maps the scans alone.
        wanted: which images are keyframes, instead of one every `keyframe_metres`.
        start, end: of the stretch that is played [s].
    """

    def new_mapper() -> SensorMapper:
        return SensorMapper(cameras, log.lidars, extract, channels, settings)

    mapper, layers, stretch = new_mapper(), None, 0
    for measured in log.stream([*cameras, *log.lidars], start=start, end=end):
        pose = log.poses.at(np.array([measured.time]))[0]
        if np.isnan(pose).any():
            continue
        if log.poses.stretch(measured.time) != stretch:
            stretch = log.poses.stretch(measured.time)
            mapper, layers = new_mapper(), None
        if isinstance(measured, Image):
            if mapper.is_keyframe(measured, pose) if wanted is None else wanted(measured):
                mapper.add_image(measured, pose)
            continue
        points, projection, keyframes = mapper.add_scan(measured, log.poses, pose)
        layers = mapper.pipeline.layers(layers)
        yield Moment(
            time=measured.time,
            vehicle=pose[:3, 3],
            layers=layers,
            points_world=points,
            projection=projection,
            views=tuple(k.view for k in keyframes),
            features=tuple(k.features for k in keyframes),
            images=tuple(k.pixels for k in keyframes),
        )


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
