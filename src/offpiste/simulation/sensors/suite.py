"""Sensors of the vehicle, and their measurements during a drive."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from offpiste.core.conventions import DT
from offpiste.core.errors import OffpisteError
from offpiste.simulation.messages import camera_info_message, image_message, points_message
from offpiste.simulation.recorder import random_turn
from offpiste.simulation.rendering.appearance import make_appearance
from offpiste.simulation.rendering.scene import Scene, world_scene
from offpiste.simulation.sample import Motion, Pose, VehicleSample
from offpiste.simulation.sensors.camera import Camera, CameraSettings, render
from offpiste.simulation.sensors.lidar import Lidar, LidarSettings
from offpiste.simulation.world.world import World

Sensor = TypeVar("Sensor", CameraSettings, LidarSettings)

_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation to body axes from those of a camera that looks ahead (z forward, x right, y down)."""
AHEAD: Final = 25
"""Samples that the vehicle may be ahead of its sensors; their messages wait in memory."""


@dataclass(frozen=True)
class SensorSuite:
    """Cameras and LiDARs of a vehicle."""

    cameras: tuple[CameraSettings, ...]
    lidars: tuple[LidarSettings, ...]

    @property
    def mountings(self) -> dict[str, Pose]:
        """`body_from_sensor` by name."""
        sensors: tuple[CameraSettings | LidarSettings, ...] = (*self.cameras, *self.lidars)
        return {sensor.name: sensor.body_from_sensor for sensor in sensors}


def full_suite() -> SensorSuite:
    """Return four cameras around the roof, a LiDAR above it, and a LiDAR at the tail that sees the driven ground.

    Rates and image sizes follow the paper (section "Visual features"), which gives no lenses and mountings.
    """
    back = mounted((-0.62, 0.0, 1.54), yaw=180.0, pitch=20.0, optical=True)
    return SensorSuite(
        cameras=(
            CameraSettings("camera_front", mounted((0.60, 0.0, 1.54), pitch=17.0, optical=True)),
            CameraSettings("camera_left", mounted((0.05, 0.62, 1.60), yaw=80.0, pitch=24.0, optical=True)),
            CameraSettings("camera_right", mounted((0.05, -0.62, 1.60), yaw=-80.0, pitch=24.0, optical=True)),
            CameraSettings("camera_back", back, rate=2.0),
        ),
        lidars=(
            LidarSettings("lidar_top", mounted((0.0, 0.0, 1.95))),
            LidarSettings("lidar_back", mounted((-1.45, 0.0, 0.75), yaw=180.0, pitch=8.0)),
        ),
    )


def light_suite() -> SensorSuite:
    """Return the front camera at 2 Hz and the upper LiDAR with 32 x 512 rays; simulated faster than real time."""
    full = full_suite()
    lidar = replace(full.lidars[0], rings=32, columns=512)
    return SensorSuite((replace(full.cameras[0], rate=2.0),), (lidar,))


def sensor_suite(profile: str) -> SensorSuite:
    """Return the sensors of a profile: `full`, `light` or `none`; raise `OffpisteError` for any other."""
    profiles = {"full": full_suite(), "light": light_suite(), "none": SensorSuite((), ())}
    if profile not in profiles:
        raise OffpisteError(f"no sensor profile is called {profile!r}", how=f"choose one of {', '.join(profiles)}")
    return profiles[profile]


def remounted(suite: SensorSuite, degrees: float, rng: np.random.Generator) -> SensorSuite:
    """Rotate sensors in place by an angle [deg], each about a random axis."""

    def rotated(sensor: Sensor) -> Sensor:
        turn = random_turn(degrees, rng) * Rotation.from_quat(sensor.body_from_sensor.orientation)
        return replace(sensor, body_from_sensor=Pose(sensor.body_from_sensor.position, turn.as_quat()))

    if degrees == 0:
        return suite
    return SensorSuite(tuple(map(rotated, suite.cameras)), tuple(map(rotated, suite.lidars)))


def mounted(
    position: tuple[float, float, float], *, yaw: float = 0.0, pitch: float = 0.0, optical: bool = False
) -> Pose:
    """Return `body_from_sensor` of a sensor at a position [m] that looks left by `yaw` and down by `pitch` [deg].

    Args:
        optical: whether the sensor has the axes of a camera (z forward, x right, y down).
    """
    turn = Rotation.from_euler("ZY", (yaw, pitch), degrees=True)
    axes = turn * Rotation.from_matrix(_OPTICAL) if optical else turn
    return Pose(np.array(position), axes.as_quat())


StampNs = Callable[[float], int]
"""Stamp [ns] of a measurement at a time since the start of the drive [s]."""
Messages = list[tuple[str, Any]]
"""Topics and messages."""


class Sensing:
    """All cameras and LiDARs of a moving vehicle.

    Args:
        suite: the sensors, with rates that divide 50 Hz.
        rng: random numbers of noise and light.
        scene: scene of the world, if already built.
        apart: whether each sensor has its own random numbers, so that LiDARs measure the same without cameras.
    """

    def __init__(
        self, world: World, suite: SensorSuite, rng: np.random.Generator, *,
        scene: Scene | None = None, apart: bool = False,
    ) -> None:  # fmt: skip
        light_seed = int(rng.integers(2**31))
        self._scene = scene or world_scene(world)
        self._appearance = make_appearance(world, self._scene, light_seed) if suite.cameras else None
        self._lidars = [Lidar(settings) for settings in suite.lidars]
        self._cameras = [Camera(settings) for settings in suite.cameras]
        sensors: tuple[Lidar | Camera, ...] = (*self._lidars, *self._cameras)
        rngs = rng.spawn(len(sensors)) if apart else [rng] * len(sensors)
        self._rngs = dict(zip((sensor.settings.name for sensor in sensors), rngs, strict=True))
        turns = [_period(lidar) for lidar in self._lidars]
        self._past: deque[VehicleSample] = deque(maxlen=max(turns, default=0) + 1)

    def observe(self, sample: VehicleSample, stamp_ns: StampNs) -> Messages:
        """Return all measurements completed by a sample."""
        self._past.append(sample)
        row, messages = round(sample.time / DT), Messages()
        for camera in self._cameras:
            if row % _period(camera) == 0:
                seed = int(self._rngs[camera.settings.name].integers(2**31))
                messages += self._image(camera, sample.pose, seed, stamp_ns(sample.time))
        for lidar in self._lidars:
            turn = _period(lidar)
            if row % turn == 0 and row >= turn:
                samples = list(self._past)[-turn - 1 :]
                messages += self._points(lidar, samples, self._rngs[lidar.settings.name], stamp_ns(samples[0].time))
        return messages

    def pass_by(self, sample: VehicleSample) -> int:
        """Skip the measurements of a sample, and return their number."""
        self._past.append(sample)
        sensors: tuple[Lidar | Camera, ...] = (*self._cameras, *self._lidars)
        return sum(round(sample.time / DT) % _period(sensor) == 0 for sensor in sensors)

    def _image(self, camera: Camera, pose: Pose, seed: int, stamp: int) -> Messages:
        s = camera.settings
        assert self._appearance is not None
        image = image_message(render(self._scene, self._appearance, camera, pose, seed), stamp, s.name)
        info = camera_info_message(s.model, stamp, s.name)
        return [(f"/{s.name}/image/compressed", image), (f"/{s.name}/camera_info", info)]

    def _points(self, lidar: Lidar, samples: list[VehicleSample], rng: np.random.Generator, stamp: int) -> Messages:
        name, scan = lidar.settings.name, lidar.scan(self._scene, Motion.of(samples), samples[0].time, rng)
        return [(f"/{name}/points", points_message(scan.points, scan.intensity, scan.ring, scan.time, stamp, name))]


def _period(sensor: Camera | Lidar) -> int:
    """Return the samples between measurements of a sensor."""
    return round(1 / (sensor.settings.rate * DT))


def observed(
    samples: Iterable[VehicleSample], sensing: Sensing | None, stamp_ns: StampNs
) -> Iterator[tuple[VehicleSample, Messages]]:
    """Yield samples with the measurements they complete, which a thread computes while the vehicle drives on."""
    if sensing is None:
        yield from ((sample, []) for sample in samples)
        return
    waiting: deque[tuple[VehicleSample, Future[Messages]]] = deque()
    beside = ThreadPoolExecutor(1, thread_name_prefix="offpiste-sensors")
    try:
        for sample in samples:
            waiting.append((sample, beside.submit(sensing.observe, sample, stamp_ns)))
            if len(waiting) > AHEAD:
                oldest, measured = waiting.popleft()
                yield oldest, measured.result()
        yield from ((sample, measured.result()) for sample, measured in waiting)
    finally:
        beside.shutdown(cancel_futures=True)
