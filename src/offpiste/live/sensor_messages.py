"""Cameras and LiDARs of a robot from its first messages, and then its images and scans."""

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError, PerceptionError
from offpiste.live.vehicle_messages import NO_STAMP
from offpiste.logs.log import Log, RawCloud, Samples, Topic
from offpiste.logs.measurements import (
    Camera,
    Cloud,
    Image,
    Lidar,
    camera_of,
    cloud_from_records,
    in_eight_bits,
    lidar_of,
    refuse_rough,
)
from offpiste.logs.ros.bag_files import heard_at
from offpiste.logs.ros.image_encodings import pixels_of
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.logs.transforms import Transform, transform_of
from offpiste.rig.camera import CameraModel, model_from_message
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import CameraSource, LidarSource
from offpiste.transport.tally import Tally

Sensors = tuple[dict[str, Camera], dict[str, Lidar]]
"""Cameras and LiDARs by name."""


class HeardLog(Log):
    """What was heard so far, as a log: calibrations, frames and transforms."""

    description = "what was heard of a robot"
    has_sensors = True

    def __init__(self) -> None:
        self.path = Path("the robot")
        self.last: dict[str, Any] = {}
        self._transforms: dict[tuple[str, str], Transform] = {}

    def hear(self, topic: str, message: Any, *, is_transforms: bool) -> None:
        """Keep the last message of a topic, since one before it may not serve, and the last of each transform."""
        if is_transforms:
            for transform in map(transform_of, message.transforms):
                self._transforms[transform.parent, transform.child] = transform
        self.last[topic] = message

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics that were heard."""
        return {name: Topic(name, message.__msgtype__, 1, ()) for name, message in self.last.items()}

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        raise LogError("numbers are read as they come", where=self.path)

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Those of all topics that the rig names."""
        return list(self._transforms.values())

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """Calibration by the topic's last CameraInfo."""
        return model_from_message(self.last[topic], topic, rectified=rectified)

    def frame(self, topic: str) -> str:
        """Frame in the last message's header."""
        return str(self.last[topic].header.frame_id).lstrip("/")


class SensorMessages:
    """Images and scans, once the calibrations that the rig needs were heard.

    Args:
        rig: of the vehicle.
        cameras: whether images are needed.

    Attributes:
        topics: that are needed.
        dropped: number of messages that cannot be used, by sensor and reason.
        left_out: optional sensors that were not heard until all others were set up, but are now.
    """

    def __init__(self, rig: Rig, *, cameras: bool) -> None:
        self._rig, self._log = rig, HeardLog()
        self._cameras = dict(rig.cameras) if cameras else {}
        self._entries: dict[str, CameraSource | LidarSource] = {**self._cameras, **rig.lidars}
        self._of = {entry.topic: name for name, entry in self._entries.items()}
        infos = [camera.info for camera in self._cameras.values() if camera.info]
        self.topics = (*self._of, *infos, *rig.frames.topics)
        self.dropped = Tally()
        self.sensors: Sensors | None = None
        self.left_out: list[str] = []
        self._why: dict[str, str] = {}
        self._lock = threading.Lock()  # messages are taken in one thread, and settled in another

    @property
    def measured(self) -> frozenset[str]:
        """Topics of images and scans."""
        return frozenset(self._of)

    @property
    def waiting_for(self) -> str:
        """What is missing before images and scans can be used, in words; empty once nothing is."""
        if self.sensors is not None:
            return ""
        silent = [entry.topic for entry in self._entries.values() if entry.topic not in self._log.last]
        heard = f"messages on {', '.join(silent)}" if silent else ""
        return "; ".join(text for text in (*self._why.values(), heard) if text) or "the first messages of its sensors"

    def take(self, topic: str, message: Any, received: float) -> Image | Cloud | None:
        """Add a message; the image or scan that it is, once it can be used; what does not serve is counted."""
        try:
            return self._take(topic, message, received)
        except Exception as error:  # noqa: BLE001 - whatever fields of a robot's messages make NumPy and OpenCV raise
            reason = f"{type(error).__name__}: {error}".splitlines()[0][:100]
            self.dropped.add(f"{self._of.get(topic, topic)}: {reason}")
            return None

    def _take(self, topic: str, message: Any, received: float) -> Image | Cloud | None:
        name = self._of.get(topic)
        with self._lock:
            if self.sensors is None:
                self._log.hear(topic, message, is_transforms=topic in self._rig.frames.topics)
                self._set_up(complete=False)
        if name is None or self.sensors is None:
            return None
        cameras, lidars = self.sensors
        time = heard_at(received, message, self._rig.clock.stamps)
        if not np.isfinite(time):
            self.dropped.add(f"{name}: {NO_STAMP}")
            return None
        if name in cameras:
            return self._image(cameras[name], topic, message, time)
        if name in lidars:
            return self._cloud(lidars[name], message, time)
        if name not in self.left_out:
            self.left_out.append(name)
        return None

    def settle(self) -> None:
        """Take the sensors that were heard, if all are there but for optional ones (see `waiting_for`)."""
        with self._lock:
            if self.sensors is None:
                self._set_up(complete=True)

    def _set_up(self, *, complete: bool) -> None:
        """Set up all sensors; with `complete`, those optional ones that were heard."""
        cameras, lidars = dict[str, Camera](), dict[str, Lidar]()
        transforms, why, missing = self._log.transforms(()), dict[str, str](), False
        for name, entry in self._entries.items():
            if entry.topic not in self._log.last:
                missing |= not (entry.optional and complete)
                continue
            try:
                refuse_rough(self._log, {name: entry})
                if name in self._cameras:
                    cameras[name] = camera_of(self._log, self._rig, name, self._cameras[name], transforms)
                else:
                    lidars[name] = lidar_of(self._log, self._rig, name, self._rig.lidars[name], transforms)
            except (LogError, PerceptionError) as error:
                why[name] = str(error)
            except Exception as error:  # noqa: BLE001 - see `take`
                why[name] = f"{name}: its messages are of another kind ({type(error).__name__})"
        self._why = why
        if not missing and not why and lidars:
            self.sensors = cameras, lidars

    def _image(self, camera: Camera, topic: str, message: Any, time: float) -> Image | None:
        pixels = pixels_of(message, topic)
        if pixels is None or (pixels.shape[1], pixels.shape[0]) != (camera.model.width, camera.model.height):
            self.dropped.add(f"{camera.name}: images that cannot be decoded, or of another size than calibrated")
            return None
        return Image(time - camera.source.delay, camera.name, in_eight_bits(pixels, camera))

    def _cloud(self, lidar: Lidar, message: Any, time: float) -> Cloud | None:
        cloud = cloud_from_records(RawCloud(time, lidar.name, points_from_message(message)), lidar)
        if not len(cloud.points):
            self.dropped.add(f"{lidar.name}: clouds without a usable point")
            return None
        return cloud
