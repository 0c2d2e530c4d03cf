"""On-line perception: from images and scans, which may be late, missing or invalid, to a map of codes."""

import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float32, UInt8

from offpiste.core.errors import PerceptionError
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.logs.measurements import Cloud, Image, Lidar
from offpiste.mapping.replay import ExtractFeatures, MapperSettings, SensorMapper
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.perception.camera import PinholeCamera
from offpiste.runtime.estimator import VehicleTrack
from offpiste.runtime.follower import MapState

Measured = TypeVar("Measured", Image, Cloud)
PassOn = Callable[[str, float, Float32[np.ndarray, "rows columns E"] | None], None]
"""Function that takes the camera, stamp [s] and codes of an image; None if it is not a keyframe."""


class Stopwatch:
    """Wall-clock times of named stages, for reports only: all, or the `last` ones of each."""

    def __init__(self, last: int | None = None) -> None:
        self._taken: defaultdict[str, deque[float]] = defaultdict(lambda: deque(maxlen=last))

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Measure the duration of the enclosed code."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._taken[stage].append(time.perf_counter() - began)

    def last_ms(self, stage: str) -> float:
        """Return the last time of a stage [ms]; 0 before the first."""
        return 1e3 * self._taken[stage][-1] if self._taken[stage] else 0.0

    def summary(self) -> dict[str, dict[str, float]]:
        """Return count, median and 95th percentile [ms], and total [s] of each stage."""
        return {
            stage: {
                "count": float(len(taken)),
                "median_ms": 1e3 * float(np.median(taken)),
                "p95_ms": 1e3 * float(np.percentile(taken, 95)),
                "total_s": float(np.sum(taken)),
            }
            for stage, taken in self._taken.items()
        }


@dataclass(frozen=True)
class SensorSetup:
    """Sensors of the vehicle and the feature extractor of its cameras."""

    lidars: Mapping[str, Lidar]
    cameras: Mapping[str, PinholeCamera] = field(default_factory=dict)  # empty for models without visual features
    extract: ExtractFeatures | None = None  # backbone and PCA of the model


class OnlineMapper:
    """Updates the map of the ground around the vehicle from each message, with the poses of a track.

    The encoder of the model is None if it reads no features from cameras.

    Attributes:
        dropped: number of dropped messages by reason.
        pass_on: called with each used image.
    """

    def __init__(
        self,
        sensors: SensorSetup,
        encoder: FeatureEncoder | None,
        track: VehicleTrack,
        settings: MapperSettings,
        watch: Stopwatch,
    ) -> None:
        self._sensors, self._encoder, self._track = sensors, encoder, track
        self._settings, self._watch = settings, watch
        self._layers: TerrainLayers | None = None
        self.uses_features = encoder is not None and sensors.extract is not None
        self._channels = encoder.size if encoder is not None and self.uses_features else 0
        self.dropped: Counter[str] = Counter()
        self.pass_on: PassOn = lambda camera, time, codes: None
        self.restart()

    def restart(self) -> None:
        """Clear the map, which does not fit the poses to come."""
        cameras = self._sensors.cameras if self.uses_features else {}
        self._mapper = SensorMapper(cameras, self._sensors.lidars, _no_codes, self._channels, self._settings)
        self.image_time = self.scan_time = -np.inf
        self._latest: dict[str, float] = {}
        self._scans: dict[str, Cloud] = {}
        self._images: dict[str, Image] = {}

    @property
    def state(self) -> MapState:
        """State for the choice of the mode."""
        return MapState(self.scan_time, self.image_time if self.uses_features else np.inf)

    def image(self, image: Image) -> None:
        """Extract features from an image if it is a keyframe; late images count with their own stamp."""
        camera, extract, encoder = self._sensors.cameras.get(image.camera), self._sensors.extract, self._encoder
        if camera is None or extract is None or encoder is None:
            return
        pose = self._pose(self._images, image.camera, image)
        if pose is None:
            return
        codes = None
        if self._mapper.keyframes.due(image, pose):  # else codes of the last keyframe, taken nearby, are still valid
            try:
                with self._watch.of("extract features"):
                    pixels = camera.rectifier(image.pixels)
                    codes = codes_of(pixels, extract, encoder)
            except PerceptionError as error:
                self.dropped[f"images: {error.what}"] += 1
                return
            self._mapper.keyframes.add(image.camera, image.time, pose, codes, pixels)
        self.image_time = max(self.image_time, image.time)
        self.pass_on(image.camera, image.time, codes)

    def coded(self, camera: str, time: float, codes: Float32[np.ndarray, "rows columns E"] | None) -> None:
        """Add the codes of an image computed elsewhere; None if it is not a keyframe."""
        pose = self._known_pose(camera, time)
        if pose is None:
            return
        if codes is not None:
            self._mapper.keyframes.add(camera, time, pose, codes, np.zeros((0, 0, 3), np.uint8))
        self.image_time = max(self.image_time, time)

    def scan(self, scan: Cloud) -> None:
        """Add the finite points of a scan to the map."""
        pose = self._pose(self._scans, scan.lidar, scan)
        if pose is None:
            return
        if not np.isfinite(scan.points).all(axis=1).any():
            self.dropped["scans without a finite point"] += 1
            return
        with self._watch.of("map scan"):
            scanned = self._mapper.add_scan(scan, self._track.poses(), pose)
        if len(scanned.points_world):
            self.scan_time = max(self.scan_time, scan.time)

    def catch_up(self) -> None:
        """Process the waiting images and scans whose poses are now known."""
        for camera in [name for name, image in self._images.items() if not self._track.awaits(image.time)]:
            self.image(self._images.pop(camera))
        for lidar in [name for name, scan in self._scans.items() if not self._track.awaits(scan.time)]:
            self.scan(self._scans.pop(lidar))

    def layers(self) -> TerrainLayers:
        """Return the layers of the current map; the next call overwrites them."""
        with self._watch.of("flatten map"):
            self._layers = self._mapper.pipeline.layers(self._layers)
        return self._layers

    def _pose(self, waiting: dict[str, Measured], sensor: str, measured: Measured) -> np.ndarray | None:
        """Return `world_from_body` of a measurement; None if it is unusable, or waits until its pose is known."""
        if not self._track.awaits(measured.time):
            return self._known_pose(sensor, measured.time)
        if sensor in waiting:
            self.dropped[f"{sensor}: replaced by a newer one"] += 1
        waiting[sensor] = measured
        return None

    def _known_pose(self, sensor: str, time: float) -> np.ndarray | None:
        """Return `world_from_body` at a stamp; None, counted in `dropped`, if the message is unusable."""
        pose, fault = self._track.pose_at(time), ""
        if not time > self._latest.get(sensor, -np.inf):
            fault = "stamps repeat or go back"
        elif not self._track.enough:
            fault = "before the first poses"
        elif pose is None:
            fault = "stamped when the pose is not known"
        if fault:
            self.dropped[f"{sensor}: {fault}"] += 1
            return None
        self._latest[sensor] = time
        return pose


@torch.no_grad()
def codes_of(
    pixels: UInt8[np.ndarray, "h w 3"], extract: ExtractFeatures, encoder: FeatureEncoder
) -> Float32[np.ndarray, "rows columns E"]:
    """Return the codes of the patches of a rectified image; raises `PerceptionError` if features are not finite."""
    features = torch.from_numpy(extract(pixels))
    if not features.isfinite().all():
        raise PerceptionError("features are not finite")
    flat = features.flatten(0, 1).to(encoder.mean.device)
    codes = encoder(flat, torch.ones(len(flat), dtype=torch.bool, device=flat.device))
    return codes.unflatten(0, features.shape[:2]).cpu().numpy()


def encoder_on(device: str, encoder: FeatureEncoder | None) -> FeatureEncoder | None:
    """Return the encoder of a model on a device, copied if necessary; None without an encoder."""
    if encoder is None or encoder.mean.device == torch.device(device):
        return encoder
    return deepcopy(encoder).to(device)


def _no_codes(pixels: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "rows columns E"]:
    return np.zeros((1, 1, 0), np.float32)
