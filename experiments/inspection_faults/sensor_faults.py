"""Faults of cameras and LiDARs: logs with one of each in three layouts, and a table of changes of these logs."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from offpiste.calibration.misfit import turned
from offpiste.logs.log import Log, RawCloud, RawImage, Samples, Times, Topic
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, load_rig
from offpiste.simulation.sample import Pose
from offpiste.simulation.sensors.camera import MODEL, Camera
from offpiste.simulation.sensors.suite import SensorSuite, light_suite, mounted

CAMERA, LIDAR = "camera_front", "lidar_top"
"""Names of the two sensors, in every layout."""
_HALF: Final = np.array([[0.5, 0.0, -0.25], [0.0, 0.5, -0.25], [0.0, 0.0, 1.0]])
"""Image coordinates at half of the resolution; the middle of the first pixel is (0, 0)."""
_MODEL: Final = replace(MODEL, width=MODEL.width // 2, height=MODEL.height // 2, matrix=_HALF @ MODEL.matrix)
_ANGLE, _DELAY = 0.5, 0.015
"""A fix is right if it leaves at most this turn [deg] and delay [s]."""
_HALF_PERIOD: Final = 8.0
"""Time over which the height rises or falls [s]."""

Random = np.random.Generator


@dataclass(frozen=True)
class Layout:
    """True mountings of the camera and the LiDAR, as `body_from_sensor`."""

    camera: Pose
    lidar: Pose

    def suite(self) -> SensorSuite:
        """The sensors, at the rates and resolutions of profile `light`."""
        (camera,), (lidar,) = light_suite().cameras, light_suite().lidars
        camera = replace(camera, body_from_sensor=self.camera, model=_MODEL)
        return SensorSuite((camera,), (replace(lidar, body_from_sensor=self.lidar),))

    def rig(self) -> Rig:
        """The proving ground's rig with these two sensors; the camera's own body is where its rays meet it."""
        camera = Camera(self.suite().cameras[0])
        seen = np.isfinite(camera.in_rows(camera.own.distance)).astype(np.uint8)
        outlines, _ = cv2.findContours(cv2.dilate(seen, np.ones((5, 5))), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        rig = load_rig("proving_ground")
        others = [f"cameras.{name}" for name in rig.cameras if name != CAMERA]
        others += [f"lidars.{name}" for name in rig.lidars if name != LIDAR]
        polygons = [line[:, 0].tolist() for line in outlines if len(line) > 2]
        return edited(rig, [*(Edit(key, None) for key in others), Edit(f"cameras.{CAMERA}.own_body", polygons)])

    def mounting(self, name: str) -> Float[np.ndarray, "4 4"]:
        """True `body_from_sensor`."""
        return (self.camera if name == CAMERA else self.lidar).matrix


_USUAL: Final = light_suite()
LAYOUTS: Final = {
    "roof": Layout(_USUAL.cameras[0].body_from_sensor, _USUAL.lidars[0].body_from_sensor),
    "mast": Layout(mounted((0.3, 0.1, 2.1), pitch=24.0, optical=True), mounted((-0.2, 0.0, 2.5), pitch=8.0)),
    "hood": Layout(mounted((1.3, -0.2, 0.9), pitch=8.0, optical=True), mounted((1.0, 0.2, 1.1), yaw=15.0, pitch=3.0)),
}


class ChangedLog(Log):
    """A log some measurements of which are changed as they are read; everything else is passed on."""

    description = "a changed log"
    has_sensors = has_messages = has_arrivals = True

    def __init__(
        self,
        log: Log,
        *,
        cloud: Callable[[RawCloud], RawCloud] | None = None,
        shown: Callable[[np.ndarray], np.ndarray] | None = None,  # stamps of the images shown instead, by stamps
        height: Callable[[np.ndarray], np.ndarray] | None = None,  # added to z of the poses, by times [s, m]
    ) -> None:
        self.path, self.warnings, self._log = log.path, log.warnings, log
        self._cloud, self._shown, self._height = cloud or (lambda one: one), shown, height
        for name in ("stamps", "transforms", "camera_model", "frame"):
            setattr(self, name, getattr(log, name))

    @property
    def topics(self) -> dict[str, Topic]:
        """Those of the log."""
        return self._log.topics

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        samples = self._log.read(topic.name, fields, stamps=stamps)
        values = samples.values.copy()
        if self._height is not None:
            values[:, [name == "pose.pose.position.z" for name in fields]] += self._height(samples.time)[:, None]
        return Samples(samples.time, values)

    def clouds(self, topic: str, **how: Any) -> Iterator[RawCloud]:
        """Clouds, changed."""
        return map(self._cloud, self._log.clouds(topic, **how))

    def images(self, topic: str, *, times: Times | None = None, **how: Any) -> Iterator[RawImage]:
        """Images with their own stamps, and the pixels of those that are shown instead."""
        times = self.stamps(topic) if times is None else times
        instead = times if self._shown is None else self._shown(times)
        images = {one.time: one for one in self._log.images(topic, times=np.unique(instead), **how)}
        for time, other in zip(times.tolist(), instead.tolist(), strict=True):
            yield replace(images[other], time=time)


@dataclass(frozen=True)
class SensorCase:
    """A log, the rig that it is read through, and where the sensors truly are; their true delay is 0."""

    log: Log
    rig: Rig
    layout: Layout
    part: tuple[float, float, float] = (0.0, 0.0, 0.0)  # place of a part of the vehicle in view, in the body frame [m]

    def with_rig(self, *entries: tuple[str, object]) -> "SensorCase":
        """The case with some entries of the rig set."""
        return replace(self, rig=edited(self.rig, [Edit(key, value) for key, value in entries]))

    def with_clouds(self, change: Callable[[np.ndarray, Random], np.ndarray], random: Random) -> "SensorCase":
        """The case with other points; `change` takes the rays of a cloud from the LiDAR, along the body axes [m]."""
        pose, seed = self.layout.lidar, int(random.integers(1 << 30))

        def changed(cloud: RawCloud) -> RawCloud:
            points = np.stack([cloud.points[axis] for axis in "xyz"], axis=1).astype(np.float64)
            rays = change(points @ pose.rotation.T, np.random.default_rng([seed, int(1e3 * cloud.time)]))
            records = cloud.points.copy()
            for axis, column in zip("xyz", (rays @ pose.rotation).T, strict=True):
                records[axis] = column
            return replace(cloud, points=records)

        return replace(self, log=ChangedLog(self.log, cloud=changed))


def mounting_key(name: str) -> str:
    """The rig's entry for the mounting of a sensor."""
    return f"cameras.{CAMERA}.body_from_camera" if name == CAMERA else f"lidars.{LIDAR}.body_from_lidar"


def sensor_errors(rig: Rig, layout: Layout, name: str) -> tuple[float, float]:
    """The turn of a rig's mounting of a sensor against the true one [deg], and the error of its delay [s]."""
    source = rig.cameras[CAMERA] if name == CAMERA else rig.lidars[LIDAR]
    if source.mounting is None:  # the log's own transform is true
        return 0.0, abs(source.delay)
    wrong = source.mounting.matrix()[:3, :3] @ layout.mounting(name)[:3, :3].T
    return float(np.rad2deg(Rotation.from_matrix(wrong).magnitude())), abs(source.delay)


def _aligned(case: SensorCase, rig: Rig, name: str) -> bool:
    angle, delay = sensor_errors(rig, case.layout, name)
    return angle <= _ANGLE and delay <= _DELAY


def _hides_part(case: SensorCase, rig: Rig) -> bool:
    """Whether the box of the own body in a rig holds the part in view."""
    box = rig.lidars[LIDAR].own_body
    return box is not None and all(low <= at <= high for low, at, high in zip(box[0], case.part, box[1], strict=True))


def _turned(case: SensorCase, strength: float, random: Random, name: str) -> SensorCase:
    axis = random.standard_normal(3)
    turn = np.append(np.deg2rad(strength) * axis / np.linalg.norm(axis), 0.0)
    matrix = turned(case.layout.mounting(name), turn)
    orientation = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
    return case.with_rig((mounting_key(name), {"position": matrix[:3, 3].tolist(), "orientation": orientation}))


def _late(case: SensorCase, strength: float, random: Random, name: str) -> SensorCase:
    """Correct stamps under a rig that wrongly says that they are early."""
    return case.with_rig((f"{mounting_key(name).rpartition('.')[0]}.delay", -strength / 1e3))


def _ghosts(case: SensorCase, strength: float, random: Random) -> SensorCase:
    """Returns moved 0.7 to 13 m lower along their rays."""

    def deeper(rays: np.ndarray, rng: Random) -> np.ndarray:
        steep = np.flatnonzero(rays[:, 2] < -0.035 * np.linalg.norm(rays[:, :2], axis=1))
        chosen = rng.choice(steep, min(round(strength / 100 * len(rays)), len(steep)), replace=False)
        rays[chosen] *= 1 + (rng.uniform(0.7, 13.0, len(chosen)) / -rays[chosen, 2])[:, None]
        return rays

    return case.with_clouds(deeper, random)


def _dust(case: SensorCase, strength: float, random: Random) -> SensorCase:
    """Returns in the air behind the vehicle, 3 to 8 m from the LiDAR, nearer along their rays."""

    def dusty(rays: np.ndarray, rng: Random) -> np.ndarray:
        length = np.linalg.norm(rays, axis=1)
        behind = np.flatnonzero((rays[:, 0] < 0) & (length > 4.0))
        chosen = rng.choice(behind, min(round(strength / 100 * len(rays)), len(behind)), replace=False)
        rays[chosen] *= (rng.uniform(3.0, np.minimum(length[chosen], 8.0)) / length[chosen])[:, None]
        return rays

    return case.with_clouds(dusty, random)


def _post(case: SensorCase, strength: float, random: Random) -> SensorCase:
    """A part of the vehicle 1.0 to 1.6 m from the LiDAR, outside the box of its own body."""
    while True:
        away, around = random.uniform(1.0, 1.6), random.uniform(-np.pi, np.pi)
        x, y, z = case.layout.lidar.position + away * np.array([np.cos(around), np.sin(around), -0.25])
        case = replace(case, part=(x, y, z))
        if not _hides_part(case, case.rig):
            break

    def with_post(rays: np.ndarray, rng: Random) -> np.ndarray:
        flat = np.hypot(rays[:, 0], rays[:, 1])
        beside = np.abs((np.arctan2(rays[:, 1], rays[:, 0]) - around + np.pi) % (2 * np.pi) - np.pi) * away
        hit = (beside < strength / 2) & (flat > away) & (np.abs(rays[:, 2]) * away / np.maximum(flat, 1e-3) < 0.5)
        rays[hit] *= (away / flat[hit])[:, None]
        return rays

    return case.with_clouds(with_post, random)


def _frozen(case: SensorCase, strength: float, random: Random) -> SensorCase:
    """One image for a part of the drive."""
    times = np.sort(case.log.stamps(case.rig.cameras[CAMERA].topic))
    length = round(strength * len(times))
    start = int(random.integers(0, len(times) - length))
    first, last = times[start], times[start + length]
    shown = ChangedLog(case.log, shown=lambda time: np.where((time >= first) & (time <= last), first, time))
    return replace(case, log=shown)


def _height(case: SensorCase, strength: float, random: Random) -> SensorCase:
    """A height of the pose that rises and falls."""

    def height(time: np.ndarray) -> np.ndarray:
        return np.asarray(strength * _HALF_PERIOD * np.abs((time - time[0]) / _HALF_PERIOD % 2 - 1))

    return replace(case, log=ChangedLog(case.log, height=height))


@dataclass(frozen=True)
class SensorFault:
    """A fault of a sensor, or of its entry in the rig."""

    name: str
    strengths: tuple[float, ...]  # the weakest first
    unit: str
    where: str  # place of the finding that counts as found
    what: str  # words of it
    change: Callable[[SensorCase, float, Random], SensorCase]
    consequences: tuple[str, ...] = ()  # places where it may show too
    fixed: Callable[[SensorCase, Rig], bool] | None = None  # whether a rig undoes it; None where no entry can


def _faults() -> Iterator[SensorFault]:
    # A turned LiDAR sees the ground and the vehicle at other places.
    for kind, name, others in (("camera", CAMERA, (CAMERA,)), ("LiDAR", LIDAR, (LIDAR, "poses", "LiDARs"))):
        turn, late, fixed = partial(_turned, name=name), partial(_late, name=name), partial(_aligned, name=name)
        yield SensorFault(f"{kind} turned", (0.5, 1.0, 2.0, 5.0), "deg", name, "degrees away", turn, others, fixed)
        yield SensorFault(f"{kind} late", (20.0, 50.0, 100.0, 200.0), "ms", name, "too late", late, others, fixed)
    returns = "% of the returns"
    yield SensorFault("ghosts", (0.01, 0.05, 0.2), returns, "LiDARs", "ghosts", _ghosts)
    yield SensorFault("dust", (0.2, 1.0, 5.0), returns, "LiDARs", "much that moves", _dust, (LIDAR,))
    seen = "sees the vehicle itself"
    yield SensorFault("post in view", (0.02, 0.05, 0.15), "m wide", LIDAR, seen, _post, ("LiDARs",), _hides_part)
    yield SensorFault("camera freezes", (0.15, 0.5), "of the drive", CAMERA, "repeats images", _frozen)
    drift = "drift in height"
    yield SensorFault("pose's height drifts", (0.02, 0.06, 0.2), "m/s", "poses", drift, _height, ("LiDARs",))


SENSOR_FAULTS: Final = {fault.name: fault for fault in _faults()}
"""All faults of sensors by name."""
