"""What the stages of the run time cost by the wall clock; nothing is decided by it.

The first half of the run time: images and scans, late, missing or invalid as they come, into a map of codes.
"""

import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float32, UInt8

from offpiste.dynamics.encoder import FeatureEncoder
from offpiste.errors import PerceptionError
from offpiste.logs.measurements import Cloud, Image, Lidar
from offpiste.mapping.replay import ExtractFeatures, MapperSettings, SensorMapper
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.perception.camera import PinholeCamera
from offpiste.runtime.estimator import VehicleTrack


class Stopwatch:
    """Collects times of named stages."""

    def __init__(self) -> None:
        self._taken: defaultdict[str, list[float]] = defaultdict(list)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Measure what is done within."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._taken[stage].append(time.perf_counter() - began)

    def summary(self) -> dict[str, dict[str, float]]:
        """For each stage: how often, the median and the 95th percentile [ms], and all of it [s]."""
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
    """Through what a vehicle sees.

    Attributes:
        cameras: none for models without features.
        extract: backbone and PCA, those that the model was trained with.
    """

    lidars: Mapping[str, Lidar]
    cameras: Mapping[str, PinholeCamera] = field(default_factory=dict)
    extract: ExtractFeatures | None = None


class OnlineMapper:
    """Keeps the map.

    Args:
        encoder: of the model; None where it reads no features, or where they come from elsewhere.
        track: the vehicle's poses.
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
        self.restart()

    def restart(self) -> None:
        """Forget the map: what was mapped fits nothing that comes."""
        extract = self._codes if self.uses_features else _blind
        cameras = self._sensors.cameras if self.uses_features else {}
        self._mapper = SensorMapper(cameras, self._sensors.lidars, extract, self._channels, self._settings)
        self.image_time = self.scan_time = -np.inf
        self._latest: dict[str, float] = {}

    def image(self, image: Image) -> None:
        """Look at an image, if it is any use; it counts with its own stamp, however late it comes."""
        if not self.uses_features or image.camera not in self._sensors.cameras:
            return
        pose = self._pose(image.camera, image.time)
        if pose is None:
            return
        if not self._mapper.is_keyframe(image, pose):
            # Seen before from here: as good as new.
            self.image_time = max(self.image_time, image.time)
            return
        try:
            with self._watch.of("extract features"):
                self._mapper.add_image(image, pose)
        except PerceptionError:
            self.dropped["images without finite features"] += 1
            return
        self.image_time = max(self.image_time, image.time)

    def scan(self, scan: Cloud) -> None:
        """Put a scan into the map, but for its points that are not finite."""
        pose = self._pose(scan.lidar, scan.time)
        if pose is None:
            return
        if not np.isfinite(scan.points).all(axis=1).any():
            self.dropped["scans without a finite point"] += 1
            return
        with self._watch.of("map scan"):
            scanned = self._mapper.add_scan(scan, self._track.poses(), pose)
        if len(scanned.points_world):
            self.scan_time = max(self.scan_time, scan.time)

    def layers(self) -> TerrainLayers:
        """The map as it is now; written over by the next call."""
        with self._watch.of("flatten map"):
            self._layers = self._mapper.pipeline.layers(self._layers)
        return self._layers

    def _pose(self, sensor: str, time: float) -> np.ndarray | None:
        """`world_from_body` at a stamp; None, and a note, where the message cannot be used."""
        if not time > self._latest.get(sensor, -np.inf):
            self.dropped[f"{sensor}: stamps repeat or go back"] += 1
            return None
        if not self._track.enough:
            self.dropped[f"{sensor}: before the first poses"] += 1
            return None
        pose = self._track.poses().at(np.array([time]))[0]
        if np.isnan(pose).any():
            self.dropped[f"{sensor}: stamped when the pose is not known"] += 1
            return None
        self._latest[sensor] = time
        return np.asarray(pose)

    @torch.no_grad()
    def _codes(self, pixels: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "rows columns E"]:
        """Backbone, PCA and encoder: codes of patches, so that the map never holds features."""
        assert self._sensors.extract is not None
        assert self._encoder is not None
        features = torch.from_numpy(self._sensors.extract(pixels))
        if not features.isfinite().all():
            raise PerceptionError("features are not finite")
        flat = features.flatten(0, 1)
        codes = self._encoder(flat, torch.ones(len(flat), dtype=torch.bool))
        return codes.unflatten(0, features.shape[:2]).numpy()


def _blind(pixels: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "rows columns E"]:
    return np.zeros((1, 1, 0), np.float32)
