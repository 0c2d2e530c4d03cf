"""Cameras and LiDARs along a drive: each measures at its own rate, as messages."""

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from offpiste.conventions import DT
from offpiste.simulation.rendering.appearance import make_appearance
from offpiste.simulation.rendering.scene import Scene, world_scene
from offpiste.simulation.sample import Motion, Pose, VehicleSample
from offpiste.simulation.sensors.camera import Camera, render
from offpiste.simulation.sensors.lidar import Lidar
from offpiste.simulation.sensors.messages import camera_info_message, image_message, points_message
from offpiste.simulation.sensors.suite import SensorSuite
from offpiste.simulation.world.world import World

StampNs = Callable[[float], int]
"""The stamp [ns] of a measurement at a time since the start of the drive [s]."""


class Sensing:
    """All cameras and LiDARs of a moving vehicle.

    Args:
        suite: the sensors; their rates must divide 50 Hz.
        rng: random numbers of noise and of the drive's light.
        scene: the world's scene, if it has been built already.
    """

    def __init__(
        self, world: World, suite: SensorSuite, rng: np.random.Generator, *, scene: Scene | None = None
    ) -> None:
        self._scene, light_seed = scene or world_scene(world), int(rng.integers(2**31))
        self._appearance = make_appearance(world, self._scene, light_seed) if suite.cameras else None
        self._cameras = [Camera(settings) for settings in suite.cameras]
        self._lidars = [Lidar(settings) for settings in suite.lidars]
        self._rng = rng
        turns = [round(1 / (lidar.settings.rate * DT)) for lidar in self._lidars]
        self._past: deque[VehicleSample] = deque(maxlen=max(turns, default=0) + 1)

    def observe(self, sample: VehicleSample, stamp_ns: StampNs) -> Iterator[tuple[str, Any]]:
        """Topics and messages of all measurements that this sample completes."""
        self._past.append(sample)
        row = round(sample.time / DT)
        for camera in self._cameras:
            if row % round(1 / (camera.settings.rate * DT)) == 0:
                yield from self._image(camera, sample, stamp_ns)
        for lidar in self._lidars:
            turn = round(1 / (lidar.settings.rate * DT))
            if row % turn == 0 and row >= turn:
                yield self._scan(lidar, list(self._past)[-turn - 1 :], stamp_ns)

    def _image(self, camera: Camera, sample: VehicleSample, stamp_ns: StampNs) -> Iterator[tuple[str, Any]]:
        s = camera.settings
        assert self._appearance is not None
        image = render(self._scene, self._appearance, camera, Pose(sample.position, sample.orientation), self._rng)
        stamp = stamp_ns(sample.time)
        yield f"/{s.name}/image/compressed", image_message(image, stamp, s.name)
        yield f"/{s.name}/camera_info", camera_info_message(s.model, stamp, s.name)

    def _scan(self, lidar: Lidar, samples: list[VehicleSample], stamp_ns: StampNs) -> tuple[str, Any]:
        motion = Motion(
            np.array([s.time for s in samples]),
            np.stack([s.position for s in samples]),
            np.stack([s.orientation for s in samples]),
        )
        scan = lidar.scan(self._scene, motion, samples[0].time, self._rng)
        stamp, name = stamp_ns(samples[0].time), lidar.settings.name
        return f"/{name}/points", points_message(scan.points, scan.intensity, scan.ring, scan.time, stamp, name)
